# SPDX-License-Identifier: Apache-2.0
"""Between the world, the frame of whoever calls, and the map's own frame (gscpe.scene.MapFrame)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.coarse import CoarseResult
from gscpe.localization.attempt import Attempt
from gscpe.localization.starts import PosePrior
from gscpe.refinement import RefinementResult
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
