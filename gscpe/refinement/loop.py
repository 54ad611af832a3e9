# SPDX-License-Identifier: Apache-2.0
"""The refinement loop (paper, Algorithm 2)."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np

from gscpe.arrays import BoolArray, Float64Array, short_repr
from gscpe.errors import SettingsError
from gscpe.geometry.pose_error import PoseDifference, pose_difference
from gscpe.photos import Photo, luminance
from gscpe.ranges import check_kinds, check_numbers, check_whole
from gscpe.refinement.agreement import photometric_agreement
from gscpe.refinement.exposure import without_flat_white
from gscpe.refinement.levels import PreparedAnchor, TurnedStarts, align_levels
from gscpe.refinement.light import LightSettings, PhotoLight
from gscpe.refinement.lucas_kanade import Alignment, LucasKanadeSettings
from gscpe.refinement.observer import RefinementObserver
from gscpe.refinement.pyramid import anchor_pyramid, photo_pyramid
from gscpe.refinement.uncertainty import UncertaintySettings, pose_uncertainty
from gscpe.refinement.visibility import VisibilitySettings, visibility_mask
from gscpe.render import RenderedView, Renders

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RefinementSettings:
    """Settings of the refinement; the defaults are the paper's where it gives one.

    Attributes:
        levels: S, times the image is halved (fewer where it would become tiny).
        smallest_side: pixels of the shorter side below which an image is not halved.
        lenient_level: halvings from which half of the pixels that a pixel is made of must be
            valid, not all: otherwise little would be left of a cluttered scene.
        agreement_level: halvings at which photo and render are compared in the end, always the
            same: small images look alike more easily.
        turned_degrees: where images are halved ``turned_level`` times or more, the smallest is
            aligned from cameras turned by so many degrees, too; 0: not.
        turned_level: see above.
        light: of photos that are overexposed, or lit unevenly.
        max_anchors: renders that serve as templates, at most.
        min_anchors: ... at least; the later ones see the scene from the aligned pose.
        rerender_pixels: the scene is rendered anew when the image has moved more than this
            since the anchor, root mean square: what the anchor shows of it, and how its
            splats overlap, depends on that.
        far_pixels: ... and when it has moved more than this, all levels are run again.
        rerender_translation: the paper's criterion instead, where given: metres since the
            anchor beyond which it is rendered anew, ...
        rerender_rotation_degrees: ... or degrees (either is enough: the paper's Algorithm 2
            says both, its text either).
        visibility: the mask.
        solver: at each level.
        uncertainty: of the covariance.
    """

    levels: int = 2
    smallest_side: int = 16
    lenient_level: int = 3
    agreement_level: int = 1
    turned_degrees: float = 5.0
    turned_level: int = 4
    light: LightSettings = field(default_factory=LightSettings)
    max_anchors: int = 5
    min_anchors: int = 1
    rerender_pixels: float = 1.0
    far_pixels: float = 8.0
    rerender_translation: float | None = None
    rerender_rotation_degrees: float | None = None
    visibility: VisibilitySettings = field(default_factory=VisibilitySettings)
    solver: LucasKanadeSettings = field(default_factory=LucasKanadeSettings)
    uncertainty: UncertaintySettings = field(default_factory=UncertaintySettings)

    def __post_init__(self) -> None:
        check_whole(self, "levels", "lenient_level", "agreement_level", "turned_level", least=0)
        check_whole(self, "smallest_side", "max_anchors", "min_anchors", least=1)
        check_numbers(self, "turned_degrees", "rerender_pixels", "far_pixels", least=0)
        check_numbers(
            self, "rerender_translation", "rerender_rotation_degrees", least=0, optional=True
        )
        check_kinds(
            self,
            light=LightSettings,
            visibility=VisibilitySettings,
            solver=LucasKanadeSettings,
            uncertainty=UncertaintySettings,
        )
        if self.min_anchors > self.max_anchors:
            raise SettingsError(
                f"refinement needs min_anchors <= max_anchors, not {self.min_anchors} and "
                f"{self.max_anchors}"
            )


@dataclass(frozen=True, eq=False)
class RefinementResult:
    """The aligned pose and how well it explains the photo.

    Attributes:
        cam_from_world: (4, 4); None when the alignment failed. Its world and unit are those of the
            splat that was rendered; in a :class:`gscpe.LocalizationResult`, the user's.
        covariance: (6, 6) of xi in ``exp(xi) @ cam_from_world``, (translation, rotation), in the
            same unit and radians.
        by_log_focal: (6,) derivative of the same xi with respect to the logarithm of the photo's
            focal lengths.
        by_principal: (6, 2) ... to its principal point, whose coordinates are counted in focal
            lengths.
        gain, bias: photo = gain * render + bias, luminance in [0, 1], where it is not clipped.
        residual: robust standard deviation of the photometric residual, luminance.
        agreement: mean local correlation of photo and render, in [-1, 1]; see
            ``RefinementSettings.agreement_level``.
        overlap: share of the image where both show the map, in [0, 1].
        pixels: number of pixels used at full size.
        anchors: renders that served as templates.
        tolerance_unit: tolerances, which are made for rooms, are divided by it: 1 where the median
            depth is between half a metre and 2 m; see :meth:`gscpe.RenderedView.tolerance_unit`.
        converged: whether the last level converged.
        reason: why it failed, or None.
        unshared: (6, 6), the part of the covariance due to directions in which photo and render
            share hardly any gradients (see :class:`gscpe.refinement.PoseUncertainty`); it holds for
            matches between the two as well. None if the alignment failed.
    """

    cam_from_world: Float64Array | None
    covariance: Float64Array | None
    gain: float
    bias: float
    residual: float
    agreement: float
    overlap: float
    pixels: int
    anchors: int
    tolerance_unit: float
    converged: bool
    reason: str | None = None
    by_log_focal: Float64Array | None = None
    by_principal: Float64Array | None = None
    unshared: Float64Array | None = None

    def __repr__(self) -> str:
        return short_repr(self)


def refine_pose(
    renderer: Renders,
    photo: Photo,
    start_cam_from_world: Float64Array,
    settings: RefinementSettings,
    observer: RefinementObserver | None = None,
    first_anchor: RenderedView | None = None,
) -> RefinementResult:
    """Aligns renders of the map to the photo, from a pose near the true one.

    Args:
        renderer: of the map's splat.
        photo: pinhole photo.
        start_cam_from_world: (4, 4), the coarse pose.
        settings: see :class:`RefinementSettings`.
        observer: is told of each anchor and each iteration.
        first_anchor: the map as the photo's camera sees it from the start, where it has been
            rendered already.
    """
    observer = observer or RefinementObserver()
    smallest_side = min(photo.camera.width, photo.camera.height)
    halvings = (smallest_side // settings.smallest_side).bit_length() - 1
    most_levels = min(settings.levels, max(0, halvings))
    compared = min(settings.agreement_level, max(0, halvings))
    photo_levels = photo_pyramid(
        luminance(photo.rgb),
        _all_valid(photo) if photo.valid is None else photo.valid,
        photo.camera,
        max(most_levels, compared),
    )
    cam_from_world = start_cam_from_world
    last_light = 1.0, 0.0
    light = PhotoLight(photo, settings.light)
    alignment: Alignment | None = None
    anchors = 0
    while anchors < settings.max_anchors:
        if first_anchor is not None and anchors == 0:
            view = first_anchor
        else:
            view = renderer.render(photo.camera, cam_from_world)
        anchors += 1
        observer.anchor_rendered(view)
        tolerance_unit = view.tolerance_unit()
        mask = visibility_mask(renderer, view, settings.visibility, tolerance_unit)
        observer.mask_made(mask)
        # After a small step the anchor is at the solution: coarse levels have nothing to add.
        fine = alignment is not None and alignment.motion_pixels <= settings.far_pixels
        levels = min(1, most_levels) if fine else most_levels
        lit = light.of(view, mask)
        gain, bias = (1.0, 0.0) if lit.changed else last_light
        pyramid = anchor_pyramid(
            lit.image, view.depth, mask, view.camera, max(levels, compared), settings.lenient_level
        )
        shown = pyramid[: levels + 1]
        if lit.clipped:
            shown = tuple(without_flat_white(level) for level in shown)
        prepared = PreparedAnchor.of(shown, (levels + 1) * [settings.solver])
        found = align_levels(
            *(prepared, photo_levels, gain, bias),
            turned=TurnedStarts(settings.turned_degrees, settings.turned_level),
            iterated=observer.iterated,
        )
        if isinstance(found, str):
            return _failed(found, anchors)
        alignment, template = found
        observer.anchor_aligned(alignment)
        # Of the render as it was before it was exposed and lit.
        last_light = alignment.gain * lit.gain, alignment.gain * lit.bias + alignment.bias
        cam_from_world = alignment.photo_from_anchor @ view.cam_from_world
        moved = pose_difference(cam_from_world, view.cam_from_world)
        _log.debug(
            "anchor %d: moved %.4f and %.3f deg (%.2f px), residual %.4f, %d pixels",
            anchors, moved.distance, moved.degrees, alignment.motion_pixels,
            alignment.residual, alignment.pixels,
        )  # fmt: skip
        if anchors >= settings.min_anchors and not _needs_new_anchor(alignment, moved, settings):
            break
    assert alignment is not None
    agreement, overlap = photometric_agreement(
        pyramid[compared], photo_levels[compared], alignment.photo_from_anchor
    )
    uncertainty = pose_uncertainty(
        template, photo_levels[0], alignment, settings.solver, settings.uncertainty
    )
    return RefinementResult(
        cam_from_world=cam_from_world,
        covariance=uncertainty.covariance,
        by_log_focal=uncertainty.by_log_focal,
        by_principal=uncertainty.by_principal,
        gain=last_light[0],
        bias=last_light[1],
        residual=alignment.residual,
        agreement=agreement,
        overlap=overlap,
        pixels=alignment.pixels,
        anchors=anchors,
        tolerance_unit=tolerance_unit,
        converged=alignment.converged,
        unshared=uncertainty.unshared,
    )


def _needs_new_anchor(
    alignment: Alignment, moved: PoseDifference, settings: RefinementSettings
) -> bool:
    """Whether the image has moved too far since the anchor for it to be the last."""
    metres, degrees = settings.rerender_translation, settings.rerender_rotation_degrees
    if metres is None and degrees is None:
        return alignment.motion_pixels > settings.rerender_pixels
    return (metres is not None and moved.distance > metres) or (
        degrees is not None and moved.degrees > degrees
    )


def _all_valid(photo: Photo) -> BoolArray:
    return np.ones(photo.rgb.shape[:2], dtype=bool)


def _failed(reason: str, anchors: int) -> RefinementResult:
    nan = float("nan")
    return RefinementResult(None, None, nan, nan, nan, nan, 0.0, 0, anchors, nan, False, reason)
