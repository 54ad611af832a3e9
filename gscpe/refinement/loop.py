# SPDX-License-Identifier: Apache-2.0
"""The refinement loop (paper, Algorithm 2)."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from gscpe.arrays import BoolArray, Float64Array
from gscpe.geometry.pose_error import PoseDifference, pose_difference
from gscpe.photos import Photo
from gscpe.refinement.agreement import photometric_agreement
from gscpe.refinement.exposure import without_flat_white
from gscpe.refinement.levels import PreparedAnchor, TurnedStarts, align_levels
from gscpe.refinement.light import PhotoLight
from gscpe.refinement.lucas_kanade import Alignment
from gscpe.refinement.observer import RefinementObserver
from gscpe.refinement.pyramid import AnchorLevel, anchor_pyramid, photo_pyramid
from gscpe.refinement.result import RefinementResult
from gscpe.refinement.rolling import pose_of_all_rows
from gscpe.refinement.settings import RefinementSettings
from gscpe.refinement.template import Template
from gscpe.refinement.uncertainty import pose_uncertainty
from gscpe.refinement.visibility import visibility_mask
from gscpe.render import RenderedView, Renders

_log = logging.getLogger(__name__)


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
    alignment = _AnchorAlignment(renderer, photo, settings, observer)
    view = first_anchor or renderer.render(photo.camera, start_cam_from_world)
    last, anchors = alignment.of(view), 1
    while (
        not isinstance(last, str)
        and anchors < settings.max_anchors
        and (anchors < settings.min_anchors or last.has_moved_too_far(settings))
    ):
        view = renderer.render(photo.camera, last.cam_from_world)
        last, anchors = alignment.of(view, last), anchors + 1
    return _failed(last, anchors) if isinstance(last, str) else alignment.result(last, anchors)


@dataclass(frozen=True, eq=False)
class _Aligned:
    """An anchor that was aligned.

    Attributes:
        anchor_from_world: (4, 4), where the anchor was rendered.
        moved: of the photo from there.
        light: gain and bias of the render as it was before it was exposed and lit.
        alignment, template: at full size.
        compared: level of the anchor at which it is compared with the photo.
        tolerance_unit: see :class:`RefinementResult`.
    """

    anchor_from_world: Float64Array
    moved: PoseDifference
    light: tuple[float, float]
    alignment: Alignment
    template: Template
    compared: AnchorLevel
    tolerance_unit: float

    @property
    def cam_from_world(self) -> Float64Array:
        """(4, 4), of the photo."""
        return self.alignment.photo_from_anchor @ self.anchor_from_world

    def has_moved_too_far(self, settings: RefinementSettings) -> bool:
        """Whether the image has moved too far since the anchor for it to be the last."""
        metres, degrees = settings.rerender_translation, settings.rerender_rotation_degrees
        if metres is None and degrees is None:
            return self.alignment.motion_pixels > settings.rerender_pixels
        return (metres is not None and self.moved.distance > metres) or (
            degrees is not None and self.moved.degrees > degrees
        )


class _AnchorAlignment:
    """Aligns one anchor after the other with a photo, whose pyramid is made once."""

    def __init__(
        self,
        renderer: Renders,
        photo: Photo,
        settings: RefinementSettings,
        observer: RefinementObserver,
    ) -> None:
        self._renderer = renderer
        self._settings = settings
        self._observer = observer
        smallest_side = min(photo.camera.width, photo.camera.height)
        halvings = max(0, (smallest_side // settings.smallest_side).bit_length() - 1)
        self._levels = min(settings.levels, halvings)
        self._compared = min(settings.agreement_level, halvings)
        self._light = PhotoLight(photo, settings.light)
        self._photo_levels = photo_pyramid(
            self._light.grey,
            _all_valid(photo) if photo.valid is None else photo.valid,
            photo.camera,
            max(self._levels, self._compared),
        )

    def of(self, view: RenderedView, before: _Aligned | None = None) -> _Aligned | str:
        """A string says why it failed.

        Args:
            view: the anchor.
            before: the anchor before, from whose pose this one was rendered.
        """
        settings = self._settings
        self._observer.anchor_rendered(view)
        unit = view.tolerance_unit()
        mask = visibility_mask(self._renderer, view, settings.visibility, unit)
        self._observer.mask_made(mask)
        lit = self._light.of(view, mask)
        # After a small step the anchor is at the solution: coarse levels have nothing to add.
        fine = before is not None and before.alignment.motion_pixels <= settings.far_pixels
        levels = min(1, self._levels) if fine else self._levels
        light = (1.0, 0.0) if lit.changed or before is None else before.light
        pyramid = anchor_pyramid(
            *(lit.image, view.depth, mask, view.camera),
            *(max(levels, self._compared), settings.lenient_level),
        )
        shown = pyramid[: levels + 1]
        if lit.clipped:
            shown = tuple(without_flat_white(level) for level in shown)
        solvers = [settings.solver, *(levels * [settings.coarse_solver()])]
        found = align_levels(
            PreparedAnchor.of(shown, solvers),
            self._photo_levels,
            *light,
            turned=TurnedStarts(settings.turned_degrees, settings.turned_level),
            iterated=self._observer.iterated,
        )
        if isinstance(found, str):
            return found
        alignment, template = found
        self._observer.anchor_aligned(alignment)
        anchor_from_world = np.asarray(view.cam_from_world)
        moved = pose_difference(alignment.photo_from_anchor @ anchor_from_world, anchor_from_world)
        _log.debug(
            "anchor moved %.4f and %.3f deg (%.2f px), residual %.4f, %d pixels",
            moved.distance, moved.degrees, alignment.motion_pixels,
            alignment.residual, alignment.pixels,
        )  # fmt: skip
        return _Aligned(
            anchor_from_world=anchor_from_world,
            moved=moved,
            light=(alignment.gain * lit.gain, alignment.gain * lit.bias + alignment.bias),
            alignment=alignment,
            template=template,
            compared=pyramid[self._compared],
            tolerance_unit=unit,
        )

    def result(self, last: _Aligned, anchors: int) -> RefinementResult:
        """What the last anchor says."""
        settings, alignment = self._settings, last.alignment
        agreement, overlap = photometric_agreement(
            last.compared, self._photo_levels[self._compared], alignment.photo_from_anchor
        )
        uncertainty = pose_uncertainty(
            *(last.template, self._photo_levels[0], alignment),
            *(settings.solver, settings.uncertainty),
        )
        pose, by_camera = last.cam_from_world, uncertainty.by_camera
        if settings.rolling_pixels > 0:
            rows = pose_of_all_rows(
                *(last.template, self._photo_levels[0], alignment, settings.solver),
                *(settings.rolling_pixels, settings.uncertainty.blocks),
            )
            pose = rows.photo_from_anchor @ last.anchor_from_world
            by_camera = rows.by_camera
        return RefinementResult(
            cam_from_world=pose,
            covariance=uncertainty.covariance,
            by_camera=by_camera,
            gain=last.light[0],
            bias=last.light[1],
            residual=alignment.residual,
            agreement=agreement,
            overlap=overlap,
            pixels=alignment.pixels,
            anchors=anchors,
            tolerance_unit=last.tolerance_unit,
            converged=alignment.converged,
            unshared=uncertainty.unshared,
        )


def _all_valid(photo: Photo) -> BoolArray:
    return np.ones(photo.rgb.shape[:2], dtype=bool)


def _failed(reason: str, anchors: int) -> RefinementResult:
    nan = float("nan")
    return RefinementResult(None, None, nan, nan, nan, nan, 0.0, 0, anchors, nan, False, reason)
