"""Whether a pose can be trusted. A wrong pose is worse than none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.coarse import CoarseResult
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import pose_difference
from gscpe.pose_prior import PosePrior
from gscpe.refinement import RefinementResult

_PRIOR_SIGMAS = 4.0


@dataclass(frozen=True)
class VerificationSettings:
    """What a pose must show (measured: docs/how-it-works.md, section Verification).

    Attributes:
        min_inliers: matches that agree with the coarse pose.
        min_inlier_share: ... as a share of all matches.
        min_spread: share of a 4x4 grid over the photo that holds an inlier.
        min_agreement: local correlation of photo and render.
        min_tracking_agreement: the same where no matches were made, only an alignment.
        sure_agreement: below it, further starts are tried too, and the best is kept.
        min_overlap: share of the photo that shows the map.
        max_shift: metres that refinement may move the coarse pose, and ... (in a map of
            unknown unit, lengths are scaled to the rendered depth)
        max_shift_degrees: ... turn it; more means that the two contradict each other.
        max_sigma: metres of the pose's standard deviation in its worst direction, and ...
        max_sigma_degrees: ... the same for the rotation; more: the photo does not tell.
    """

    min_inliers: int = 20
    min_inlier_share: float = 0.5
    min_spread: float = 0.2
    min_agreement: float = 0.25
    min_tracking_agreement: float = 0.5
    sure_agreement: float = 0.6
    min_overlap: float = 0.2
    max_shift: float = 0.1
    max_shift_degrees: float = 3.0
    max_sigma: float = 0.1
    max_sigma_degrees: float = 3.0


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
    coarse_cam_from_world: Float64Array,
    refined: RefinementResult,
    settings: VerificationSettings,
) -> str | None:
    """Why the refined pose cannot be trusted, or None."""
    if refined.cam_from_world is None or refined.covariance is None:
        return refined.reason or "the refinement failed"
    doubt = _doubt_about_picture(refined, settings.min_agreement, settings)
    if doubt is not None:
        return doubt
    shift = pose_difference(refined.cam_from_world, coarse_cam_from_world)
    unit = refined.metres_per_unit
    if shift.distance * unit > settings.max_shift or shift.degrees > settings.max_shift_degrees:
        return (
            f"matches and image alignment contradict each other by {shift.distance:.3f} "
            f"and {shift.degrees:.2f} degrees"
        )
    return _doubt_about_covariance(refined.covariance, unit, settings)


def doubt_about_tracked(
    prior: PosePrior, refined: RefinementResult, settings: VerificationSettings
) -> str | None:
    """Why a pose that was refined from a prior, without matches, cannot be trusted, or None."""
    if refined.cam_from_world is None or refined.covariance is None:
        return refined.reason or "the refinement failed"
    if not refined.converged:
        return "the alignment from the prior did not converge"
    doubt = _doubt_about_picture(refined, settings.min_tracking_agreement, settings)
    if doubt is not None:
        return doubt
    shift = pose_difference(refined.cam_from_world, prior.cam_from_world)
    if (
        shift.distance > _PRIOR_SIGMAS * prior.translation_sigma
        or shift.degrees > _PRIOR_SIGMAS * prior.rotation_sigma_degrees
    ):
        return f"the alignment left the prior by {shift.distance:.3f} and {shift.degrees:.2f} deg"
    return _doubt_about_covariance(refined.covariance, refined.metres_per_unit, settings)


def _doubt_about_picture(
    refined: RefinementResult, min_agreement: float, settings: VerificationSettings
) -> str | None:
    if refined.overlap < settings.min_overlap:
        return f"only {refined.overlap:.0%} of the photo shows the map"
    if not refined.agreement >= min_agreement:  # also NaN: nothing to compare
        return (
            f"the map does not look like the photo at the estimated pose (correlation "
            f"{refined.agreement:.2f}, {min_agreement:.2f} needed)"
        )
    return None


def _doubt_about_covariance(
    covariance: Float64Array, metres_per_unit: float, settings: VerificationSettings
) -> str | None:
    """In ``exp(xi)`` the camera's centre moves by minus the translation, turned, and by what the
    rotation does to it, which is nothing: the centre is the origin of its own frame."""
    translation, rotation = (
        float(np.sqrt(max(np.linalg.eigvalsh(block)[-1], 0.0)))
        for block in (covariance[:3, :3], covariance[3:, 3:])
    )
    degrees = float(np.degrees(rotation))
    if translation * metres_per_unit > settings.max_sigma or degrees > settings.max_sigma_degrees:
        return (
            "the photo does not determine the pose: standard deviations of "
            f"{translation:.3f} and {degrees:.2f} degrees"
        )
    return None
