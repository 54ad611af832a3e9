# SPDX-License-Identifier: Apache-2.0
"""Whether a pose can be trusted. A wrong pose is worse than none."""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.coarse import CoarseResult
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import pose_difference
from gscpe.geometry.spread import spread_over_image
from gscpe.localization.fusion import FusionSettings, fuse_matches_and_alignment
from gscpe.localization.sigmas import sigmas_text, worst_sigmas
from gscpe.localization.starts import PosePrior
from gscpe.localization.verification_settings import VerificationSettings
from gscpe.localization.wrong_camera import doubt_about_camera
from gscpe.refinement import RefinementResult
from gscpe.scene import MapFrame

MORE_IN_VIEW = (
    "if it shows this place, try a photo with more of it in view, taken nearer to the map's "
    "viewpoints"
)
"""What to do where matches are few, or cover little."""

_CAMERA_OR_PLACE = (
    "if it shows this place, check that nothing covers it and that the camera's intrinsics are "
    "right, or make the map again if the place has changed"
)
_SURER_PRIOR = "give a larger --prior-sigma (PosePrior), or no prior"


def doubt_about_coarse(
    coarse: CoarseResult, camera: Camera, settings: VerificationSettings, moved: bool = False
) -> str | None:
    """Why the coarse pose cannot be trusted, or None. ``moved``: other matches of this photo agreed
    on two poses, so that these, which agree on one, may be those of what has been moved."""
    if coarse.cam_from_world is None:
        return (
            f"no pose agrees with the {coarse.matches} matches between photo and map: "
            f"{MORE_IN_VIEW}"
        )
    wrong = doubt_about_camera(coarse, camera, settings.camera)
    if wrong is not None and _explains_more(coarse, settings):
        return wrong
    return (
        _doubt_about_matches(coarse, settings)
        or _doubt_about_spread(coarse, camera, settings, moved)
        or wrong
    )


def _explains_more(coarse: CoarseResult, settings: VerificationSettings) -> bool:
    """Whether so many matches agree with another camera that this is what is wrong."""
    inliers = 0 if coarse.intrinsics is None else coarse.intrinsics.inliers
    return inliers >= max(settings.min_inliers, settings.min_inlier_share * coarse.matches)


def _doubt_about_matches(coarse: CoarseResult, settings: VerificationSettings) -> str | None:
    """So many agree, and so many of all."""
    if coarse.inliers < settings.min_inliers:
        return (
            f"only {coarse.inliers} matches agree with a pose ({settings.min_inliers} needed): "
            f"{MORE_IN_VIEW}"
        )
    share = inlier_share(coarse, settings)
    if share < settings.min_inlier_share:
        return (
            f"only {share:.0%} of the matches agree ({settings.min_inlier_share:.0%} needed): "
            f"{MORE_IN_VIEW}"
        )
    return None


def _doubt_about_spread(
    coarse: CoarseResult, camera: Camera, settings: VerificationSettings, moved: bool
) -> str | None:
    """What stayed is spread over more of the photo than what has been moved."""
    spread = spread_over_image(coarse.inlier_pixels, camera)
    rivals = len(coarse.rival_pixels)
    more = settings.rival_margin + spread_over_image(coarse.rival_pixels, camera)
    if rivals and spread < max(settings.rival_spread, more):
        return (
            f"{coarse.inliers} and {rivals} matches agree with two poses that contradict each "
            "other: something has been moved, and it is not clear what has not"
        )
    least = settings.rival_spread if moved else settings.min_spread
    if spread < least:
        cause = "something has been moved, and the matches that agree" if moved else "the matches"
        return f"{cause} cover only {spread:.0%} of the photo ({least:.0%} needed): {MORE_IN_VIEW}"
    return None


def inlier_share(coarse: CoarseResult, settings: VerificationSettings) -> float:
    """Of the matches, the share that agrees; without those of something that has been moved, where
    so many are left that they cannot be chance."""
    moved = len(coarse.rival_pixels) if coarse.inliers >= settings.decisive_inliers else 0
    return coarse.inliers / max(coarse.matches - moved, 1)


def are_decisive(coarse: CoarseResult, camera: Camera, settings: VerificationSettings) -> bool:
    """Whether so many matches agree, from all over the photo, that it shows this place."""
    return (
        coarse.inliers >= settings.decisive_inliers
        and inlier_share(coarse, settings) >= settings.decisive_inlier_share
        and spread_over_image(coarse.inlier_pixels, camera) >= settings.decisive_spread
    )


@dataclass(frozen=True)
class Comparison:
    """What matches and alignment say of each other, in metres (see ``max_shift``) and degrees.

    Attributes:
        shift, shift_degrees: between the two; 0 where the alignment determines no pose, so
            that it cannot contradict the matches.
        sigma, sigma_degrees: standard deviations of the alignment in the worst direction; where
            it determines no pose, twice those of the mean of both.
    """

    shift: float
    shift_degrees: float
    sigma: float
    sigma_degrees: float


def compare_stages(
    coarse: CoarseResult,
    aligned: RefinementResult,
    settings: VerificationSettings,
    fusion: FusionSettings,
) -> Comparison:
    """How well matches and alignment go together; both have a pose."""
    assert aligned.cam_from_world is not None
    assert aligned.covariance is not None
    assert coarse.cam_from_world is not None
    unit = aligned.tolerance_unit
    sigma, sigma_degrees = worst_sigmas(aligned.covariance, unit)
    if sigma <= settings.max_sigma and sigma_degrees <= settings.max_sigma_degrees:
        shift = pose_difference(aligned.cam_from_world, coarse.cam_from_world)
        return Comparison(shift.distance * unit, shift.degrees, sigma, sigma_degrees)
    if coarse.covariance is None:
        return Comparison(0.0, 0.0, sigma, sigma_degrees)
    _, covariance = fuse_matches_and_alignment(
        coarse.cam_from_world,
        coarse.covariance,
        aligned.cam_from_world,
        aligned.covariance,
        fusion,
        aligned.unshared,
    )
    sigma, sigma_degrees = worst_sigmas(covariance, unit)
    return Comparison(0.0, 0.0, 2.0 * sigma, 2.0 * sigma_degrees)


def doubt_about_aligned(
    coarse: CoarseResult,
    aligned: RefinementResult,
    camera: Camera,
    settings: VerificationSettings,
    fusion: FusionSettings,
    frame: MapFrame,
) -> str | None:
    """Why the aligned pose cannot be trusted, or None."""
    if aligned.cam_from_world is None or aligned.covariance is None:
        return aligned.reason or "the refinement failed"
    decisive = are_decisive(coarse, camera, settings)
    least = settings.decisive_agreement if decisive else settings.min_agreement
    doubt = _doubt_about_picture(aligned, least, settings)
    if doubt is not None:
        return doubt
    found = compare_stages(coarse, aligned, settings, fusion)
    if found.shift > settings.max_shift or found.shift_degrees > settings.max_shift_degrees:
        return (
            "matches and image alignment contradict each other by "
            f"{frame.length_text(found.shift / aligned.tolerance_unit)} and "
            f"{found.shift_degrees:.2f} degrees: {_CAMERA_OR_PLACE}"
        )
    unit = aligned.tolerance_unit
    return _doubt_about_sigmas(found.sigma, found.sigma_degrees, unit, settings, frame)


def doubt_about_tracked(
    prior: PosePrior, aligned: RefinementResult, settings: VerificationSettings, frame: MapFrame
) -> str | None:
    """Why a pose that was aligned from a prior, without matches, cannot be trusted, or None."""
    if aligned.cam_from_world is None or aligned.covariance is None:
        return aligned.reason or "the refinement failed"
    if not aligned.converged:
        return f"the alignment from the prior did not converge: {_SURER_PRIOR}"
    doubt = _doubt_about_picture(aligned, settings.min_tracking_agreement, settings)
    if doubt is not None:
        return doubt
    shift = pose_difference(aligned.cam_from_world, prior.cam_from_world)
    if (
        shift.distance > settings.prior_sigmas * prior.translation_sigma
        or shift.degrees > settings.prior_sigmas * prior.rotation_sigma_degrees
    ):
        return (
            f"the alignment moved away from the prior by {frame.length_text(shift.distance)} and "
            f"{shift.degrees:.2f} degrees: {_SURER_PRIOR}"
        )
    unit = aligned.tolerance_unit
    return _doubt_about_sigmas(*worst_sigmas(aligned.covariance, unit), unit, settings, frame)


def _doubt_about_picture(
    aligned: RefinementResult, min_agreement: float, settings: VerificationSettings
) -> str | None:
    if aligned.overlap < settings.min_overlap:
        return (
            f"only {aligned.overlap:.0%} of the photo shows the map ({settings.min_overlap:.0%} "
            f"needed): {MORE_IN_VIEW}"
        )
    if not aligned.agreement >= min_agreement:  # also NaN: nothing to compare
        return (
            f"the map does not look like the photo at the estimated pose (correlation "
            f"{aligned.agreement:.2f}, {min_agreement:.2f} needed): {_CAMERA_OR_PLACE}"
        )
    return None


def _doubt_about_sigmas(
    metres: float,
    degrees: float,
    tolerance_unit: float,
    settings: VerificationSettings,
    frame: MapFrame,
) -> str | None:
    if metres <= settings.max_sigma and degrees <= settings.max_sigma_degrees:
        return None
    sigmas = sigmas_text(metres, degrees, tolerance_unit, frame)
    return (
        f"the photo does not determine the pose ({sigmas}): try one with more edges and texture "
        "in view, in more than one direction"
    )
