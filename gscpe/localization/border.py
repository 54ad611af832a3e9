"""Between the world, the frame of whoever calls, and the map's own frame (gscpe.scene.MapFrame)."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from gscpe.coarse import CoarseResult
from gscpe.localization.attempt import Attempt
from gscpe.localization.starts import PosePrior
from gscpe.refinement import RefinementResult
from gscpe.render import RenderedView
from gscpe.scene import MapFrame

_Stage = TypeVar("_Stage", CoarseResult, RefinementResult)


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
        coarse=_stage_in_world(attempt.coarse, frame),
        aligned=_stage_in_world(attempt.aligned, frame),
    )


def _stage_in_world(result: _Stage | None, frame: MapFrame) -> _Stage | None:
    if result is None or result.cam_from_world is None:
        return result
    covariances = {"covariance": result.covariance}
    if isinstance(result, RefinementResult):
        covariances["unshared"] = result.unshared
    in_world = {
        name: None if covariance is None else frame.world_covariance(covariance)
        for name, covariance in covariances.items()
    }
    return replace(result, cam_from_world=frame.cam_from_world(result.cam_from_world), **in_world)


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
