"""Whether a pose can be trusted. A wrong pose is worse than none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.coarse import CoarseResult
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import pose_difference
from gscpe.refinement import RefinementResult


@dataclass(frozen=True)
class VerificationSettings:
    """What a pose must show (measured: docs/how-it-works.md, section Verification).

    Attributes:
        min_inliers: matches that agree with the coarse pose.
        min_inlier_share: ... as a share of all matches.
        min_spread: share of a 4x4 grid over the photo that holds an inlier.
        min_agreement: local correlation of photo and render.
        min_overlap: share of the photo that shows the map.
        max_shift: metres that refinement may move the coarse pose, and ...
            (not checked where the map's unit is unknown)
        max_shift_degrees: ... turn it; more means that the two contradict each other.
    """

    min_inliers: int = 20
    min_inlier_share: float = 0.2
    min_spread: float = 0.2
    min_agreement: float = 0.3
    min_overlap: float = 0.2
    max_shift: float = 0.1
    max_shift_degrees: float = 3.0


def inlier_spread(inlier_pixels: Float64Array, camera: Camera) -> float:
    """Share of a 4x4 grid over the image, in [0, 1], whose cells hold at least one of the
    pixels, (N, 2)."""
    columns = np.clip(4.0 * inlier_pixels[:, 0] / camera.width, 0, 3).astype(int)
    rows = np.clip(4.0 * inlier_pixels[:, 1] / camera.height, 0, 3).astype(int)
    return len(set(zip(rows.tolist(), columns.tolist(), strict=True))) / 16.0


def doubt_about_coarse(
    coarse: CoarseResult, camera: Camera, settings: VerificationSettings
) -> str | None:
    """Why the coarse pose cannot be trusted, or None."""
    if coarse.cam_from_world is None:
        return f"no pose agrees with the {coarse.matches} matches between photo and map"
    if coarse.inliers < settings.min_inliers:
        return f"only {coarse.inliers} matches agree with a pose ({settings.min_inliers} needed)"
    share = coarse.inliers / max(coarse.matches, 1)
    if share < settings.min_inlier_share:
        return f"only {share:.0%} of the matches agree ({settings.min_inlier_share:.0%} needed)"
    spread = inlier_spread(coarse.inlier_pixels, camera)
    if spread < settings.min_spread:
        return (
            f"the matches cover only {spread:.0%} of the photo ({settings.min_spread:.0%} needed)"
        )
    return None


def doubt_about_refined(
    coarse: CoarseResult,
    refined: RefinementResult,
    settings: VerificationSettings,
    metres_per_unit: float | None,
) -> str | None:
    """Why the refined pose cannot be trusted, or None."""
    if refined.cam_from_world is None or coarse.cam_from_world is None:
        return refined.reason or "the refinement failed"
    if refined.overlap < settings.min_overlap:
        return f"only {refined.overlap:.0%} of the photo shows the map"
    if not refined.agreement >= settings.min_agreement:  # also NaN: nothing to compare
        return (
            f"the map does not look like the photo at the estimated pose (correlation "
            f"{refined.agreement:.2f}, {settings.min_agreement:.2f} needed)"
        )
    shift = pose_difference(refined.cam_from_world, coarse.cam_from_world)
    too_far = shift.distance * (metres_per_unit or 0.0) > settings.max_shift
    if too_far or shift.degrees > settings.max_shift_degrees:
        return (
            f"matches and image alignment contradict each other by {shift.distance:.3f} "
            f"and {shift.degrees:.2f} degrees"
        )
    return None
