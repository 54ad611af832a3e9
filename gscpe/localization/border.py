# SPDX-License-Identifier: Apache-2.0
"""Between the world, the frame of whoever calls, and the map's own frame (gscpe.scene.MapFrame)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gscpe.arrays import BoolArray, Float64Array
from gscpe.coarse import AbsolutePose, CoarseResult
from gscpe.localization.attempt import Attempt
from gscpe.localization.observer import Observer
from gscpe.localization.starts import PosePrior
from gscpe.matching import Matches
from gscpe.refinement import Alignment, RefinementResult
from gscpe.render import RenderedView
from gscpe.scene import MapFrame


def prior_in_map(prior: PosePrior, frame: MapFrame) -> PosePrior:
    """A prior with respect to the map."""
    return replace(
        prior,
        cam_from_world=frame.cam_from_map(prior.cam_from_world),
        translation_sigma=frame.scale * prior.translation_sigma,
    )


def attempt_in_world(attempt: Attempt, frame: MapFrame) -> Attempt:
    """An attempt whose poses are with respect to the world."""
    start = attempt.start
    return replace(
        attempt,
        start=replace(start, cam_from_world=frame.cam_from_world(start.cam_from_world)),
        coarse=_coarse_in_world(attempt.coarse, frame),
        aligned=_aligned_in_world(attempt.aligned, frame),
    )


def _coarse_in_world(coarse: CoarseResult | None, frame: MapFrame) -> CoarseResult | None:
    if coarse is None or coarse.cam_from_world is None:
        return coarse
    intrinsics = coarse.intrinsics
    return replace(
        coarse,
        cam_from_world=frame.cam_from_world(coarse.cam_from_world),
        covariance=_covariance_in_world(coarse.covariance, frame),
        intrinsics=intrinsics
        and replace(intrinsics, cam_from_world=frame.cam_from_world(intrinsics.cam_from_world)),
    )


def _aligned_in_world(aligned: RefinementResult | None, frame: MapFrame) -> RefinementResult | None:
    if aligned is None or aligned.cam_from_world is None:
        return aligned
    return replace(
        aligned,
        cam_from_world=frame.cam_from_world(aligned.cam_from_world),
        covariance=_covariance_in_world(aligned.covariance, frame),
        unshared=_covariance_in_world(aligned.unshared, frame),
        by_camera=_xi_in_world(aligned.by_camera, frame),
    )


def _xi_in_world(by: Float64Array | None, frame: MapFrame) -> Float64Array | None:
    """Columns of (translation, rotation), (6, N), in world units."""
    return None if by is None else by / np.repeat([frame.scale, 1.0], 3)[:, None]


def _covariance_in_world(covariance: Float64Array | None, frame: MapFrame) -> Float64Array | None:
    return None if covariance is None else frame.world_covariance(covariance)


def view_in_world(view: RenderedView, frame: MapFrame) -> RenderedView:
    """A render whose depths and pose are with respect to the world."""
    if frame.scale == 1.0:
        return replace(view, cam_from_world=frame.cam_from_world(view.cam_from_world))
    scale = np.float32(frame.scale)
    return replace(
        view,
        depth=view.depth / scale,
        depth_variance=view.depth_variance / scale**2,
        cam_from_world=frame.cam_from_world(view.cam_from_world),
    )


class InWorld(Observer):
    """Tells an observer what is done in the map's frame with respect to the world.

    Args:
        observer: of the caller.
        frame: of the map.
    """

    def __init__(self, observer: Observer, frame: MapFrame) -> None:
        self._observer, self._frame = observer, frame

    def round_done(
        self, view: RenderedView, matches: Matches, estimate: AbsolutePose | None
    ) -> None:
        if estimate is not None:
            estimate = replace(
                estimate,
                cam_from_world=self._frame.cam_from_world(estimate.cam_from_world),
                covariance=self._frame.world_covariance(estimate.covariance),
            )
        self._observer.round_done(view_in_world(view, self._frame), matches, estimate)

    def anchor_rendered(self, view: RenderedView) -> None:
        self._observer.anchor_rendered(view_in_world(view, self._frame))

    def mask_made(self, mask: BoolArray) -> None:
        self._observer.mask_made(mask)

    def iterated(self, photo_from_anchor: Float64Array) -> None:
        self._observer.iterated(self._motion(photo_from_anchor))

    def anchor_aligned(self, alignment: Alignment) -> None:
        motion = self._motion(alignment.photo_from_anchor)
        self._observer.anchor_aligned(replace(alignment, photo_from_anchor=motion))

    def attempted(self, attempt: Attempt) -> None:
        self._observer.attempted(attempt_in_world(attempt, self._frame))

    def _motion(self, photo_from_anchor: Float64Array) -> Float64Array:
        """Between two cameras: the origin does not matter to it."""
        moved = photo_from_anchor.copy()
        moved[:3, 3] /= self._frame.scale
        return moved
