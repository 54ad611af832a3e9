# SPDX-License-Identifier: Apache-2.0
"""One frame aligned with one anchor, and whether that can be believed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry import se3
from gscpe.localization.sigmas import sigmas_text, worst_sigmas
from gscpe.refinement import Alignment
from gscpe.refinement.agreement import BlockAgreement, block_agreement
from gscpe.refinement.levels import TurnedStarts, align_levels
from gscpe.refinement.uncertainty import pose_uncertainty
from gscpe.scene import MapFrame
from gscpe.tracking.anchors import Anchor
from gscpe.tracking.frames import Frame
from gscpe.tracking.motion import Prediction
from gscpe.tracking.settings import TrackingSettings, TrustSettings

_DEVIATIONS = 3.0
"""Of the expected motion that an alignment must bridge."""
_BASIN = 2.0
"""Pixels that an alignment bridges in one image."""
_TURNED_DEGREES = 5.0
_JUDGED_EVERY = 4
_ALIKE = 0.02
"""Differences of correlations that are none."""


@dataclass(frozen=True, eq=False)
class Followed:
    """A frame that was aligned.

    Attributes:
        cam_from_world: (4, 4).
        anchor: with which.
        alignment: of its largest image.
        agreement: of the two.
        surprise_pixels: how far the image was from where it was expected.
    """

    cam_from_world: Float64Array
    anchor: Anchor
    alignment: Alignment
    agreement: BlockAgreement
    surprise_pixels: float


def follow(
    frame: Frame,
    anchor: Anchor,
    expected: Prediction,
    light: tuple[float, float],
    settings: TrackingSettings,
    wide: bool = False,
    begin_at: Float64Array | None = None,
) -> Followed | str:
    """Aligns a frame; a string says why that failed.

    Args:
        frame: and ...
        anchor: ... with what.
        expected: where its camera is expected.
        light: gain and bias to start from.
        settings: of the tracker.
        wide: begin in the smallest image, from turned cameras too, however sure the expectation.
        begin_at: (4, 4) ``cam_from_world`` to start from, where that is not what was expected.
    """
    anchor_from_world = anchor.cam_from_world
    begin = expected.cam_from_world if begin_at is None else begin_at
    start = begin @ se3.inverse(anchor_from_world)
    reach = _DEVIATIONS * expected.pixels(anchor.template.motion)
    coarsest = max(1, int(np.ceil(np.log2(max(reach, _BASIN) / _BASIN))))
    found = align_levels(
        *(anchor.prepared, frame.levels, *light, start),
        turned=TurnedStarts(_TURNED_DEGREES, 0) if wide else None,
        coarsest=None if wide else coarsest,
    )
    if isinstance(found, str):
        return found
    alignment, _ = found
    template = anchor.prepared.templates[anchor.compared]
    assert template is not None
    photo_from_anchor = alignment.photo_from_anchor
    agreement = block_agreement(
        template, frame.levels[anchor.compared], photo_from_anchor, anchor.blocks
    )
    cam_from_world = se3.nearest_rigid(photo_from_anchor @ anchor_from_world)
    step = se3.log(cam_from_world @ se3.inverse(expected.cam_from_world))
    surprise = float(np.sqrt(step @ anchor.template.motion @ step))
    return Followed(cam_from_world, anchor, alignment, agreement, surprise)


def doubt_about_picture(followed: Followed, trust: TrustSettings, sure: bool) -> str | None:
    """Why the frame may not show what the anchor shows, or None.

    Args:
        followed: the frame.
        trust: what it must show.
        sure: whether it must show more, because nothing else speaks for the pose.
    """
    agreement, alignment = followed.agreement, followed.alignment
    if not alignment.converged:
        return "the alignment with the map did not converge"
    if agreement.overlap < trust.min_overlap:
        return f"only {agreement.overlap:.0%} of the map's picture is visible in the frame"
    if not 1.0 / trust.max_gain <= alignment.gain <= trust.max_gain:
        return f"the frame's contrast is {alignment.gain:.2g} times that of the map"
    least = trust.min_agreement
    if sure or followed.surprise_pixels > trust.max_surprise_pixels:
        least = max(least, trust.sure_agreement)
    if not agreement.correlation >= least:  # also NaN: nothing to compare
        return (
            f"the map does not look like the frame (correlation {agreement.correlation:.2f}, "
            f"{least:.2f} needed)"
        )
    if agreement.alike < trust.min_alike:
        return f"only {agreement.alike:.0%} of the frame looks like the map"
    return None


def covariance_of(
    followed: Followed, frame: Frame, settings: TrackingSettings, all_pixels: bool = False
) -> Float64Array:
    """(6, 6) of xi in ``exp(xi) @ cam_from_world``, world units and radians.

    Args:
        followed: the frame, as it was aligned.
        frame: the frame.
        settings: of the tracker.
        all_pixels: of the template, not the few by which frames are judged.
    """
    judged = followed.anchor.template if all_pixels else followed.anchor.judged
    uncertainty = pose_uncertainty(
        *(judged, frame.levels[0], followed.alignment, settings.solver, settings.uncertainty)
    )
    by_camera = uncertainty.by_camera
    of_camera = by_camera @ frame.camera.covariance_matrix() @ by_camera.T
    return np.asarray(uncertainty.covariance + of_camera)


class Judge:
    """Says how sure frames are.

    The covariance takes as long as the alignment, and hardly changes from one frame to the next,
    as long as they look alike: it is estimated anew where a frame fits its anchor otherwise than
    the last one that was judged, and at least for every fourth frame and each anchor.
    """

    def __init__(self, settings: TrackingSettings) -> None:
        self._settings = settings
        self._last: tuple[int, Followed, Float64Array] | None = None

    def covariance(self, followed: Followed, frame: Frame) -> Float64Array:
        """As :func:`covariance_of`."""
        if self._last is not None:
            index, last, covariance = self._last
            if frame.index - index < _JUDGED_EVERY and _fit_alike(followed, last):
                return covariance
        covariance = covariance_of(followed, frame, self._settings)
        self._last = frame.index, followed, covariance
        return covariance


def _fit_alike(one: Followed, other: Followed) -> bool:
    """Whether two frames fit the same anchor equally well."""
    return (
        one.anchor is other.anchor
        and abs(one.agreement.correlation - other.agreement.correlation) < _ALIKE
        and abs(one.agreement.alike - other.agreement.alike) < 5.0 * _ALIKE
        and abs(one.alignment.residual / other.alignment.residual - 1.0) < 5.0 * _ALIKE
        and abs(one.alignment.pixels / other.alignment.pixels - 1.0) < 5.0 * _ALIKE
    )


def doubt_about_sigmas(
    covariance: Float64Array, anchor: Anchor, trust: TrustSettings, frame: MapFrame
) -> str | None:
    """Why the frame does not determine its pose, or None."""
    metres, degrees = worst_sigmas(covariance, anchor.tolerance_unit)
    if metres <= trust.max_sigma and degrees <= trust.max_sigma_degrees:
        return None
    unit = anchor.tolerance_unit / frame.scale
    return f"the frame does not determine the pose ({sigmas_text(metres, degrees, unit, frame)})"
