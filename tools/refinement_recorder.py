"""Follows a refinement through time: where its pose was when, and what took how long."""

from __future__ import annotations

import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, Callable, Iterator, cast
from unittest import mock

import numpy as np

from gscpe import Camera
from gscpe.arrays import Float64Array
from gscpe.refinement import (
    RefinementResult,
    RefinementSettings,
    loop,
    lucas_kanade,
    refine_pose,
    visibility,
)
from gscpe.render import RenderedView, Renderer
from gscpe.scene import Photo


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A pose on its way; the first entry is the start.

    Attributes:
        seconds: (T,) since the start, all included.
        solver_seconds: (T,) the same without renders and masks.
        cam_from_world: (T, 4, 4).
        anchor_rendering: seconds of the renders that served as templates.
        mask_rendering: seconds of the renders for masks.
        masking: seconds of the masks without their renders.
        anchors, mask_views: renders of either kind.
    """

    seconds: Float64Array
    solver_seconds: Float64Array
    cam_from_world: Float64Array
    anchor_rendering: float
    mask_rendering: float
    masking: float
    anchors: int
    mask_views: int


class Recorder:
    """Stands for the renderer, keeps time, and is told of poses."""

    def __init__(self, renderer: Any) -> None:
        self._renderer = renderer
        self._begin = time.perf_counter()
        self._anchor_rendering = self._mask_rendering = self._masking = 0.0
        self._anchors = self._mask_views = 0
        self._in_mask = False
        self._points: list[tuple[float, float, Float64Array]] = []
        self._anchor: Float64Array | None = None

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        begin = time.perf_counter()
        view: RenderedView = self._renderer.render(camera, cam_from_world)
        seconds = time.perf_counter() - begin
        if self._in_mask:
            self._mask_views += 1
            self._mask_rendering += seconds
        else:
            self._anchors += 1
            self._anchor_rendering += seconds
            self._anchor = view.cam_from_world
        return view

    def visibility_mask(self, *arguments: Any) -> Any:
        begin, rendering = time.perf_counter(), self._mask_rendering
        self._in_mask = True
        mask = visibility.visibility_mask(*arguments)
        self._in_mask = False
        self._masking += time.perf_counter() - begin - (self._mask_rendering - rendering)
        return mask

    def reached(self, cam_from_world: Float64Array) -> None:
        seconds = time.perf_counter() - self._begin
        others = self._anchor_rendering + self._mask_rendering + self._masking
        self._points.append((seconds, seconds - others, np.array(cam_from_world)))

    def reached_from_anchor(self, photo_from_anchor: Float64Array) -> None:
        assert self._anchor is not None
        self.reached(photo_from_anchor @ self._anchor)

    def trajectory(self) -> Trajectory:
        seconds, solver_seconds, poses = zip(*self._points, strict=True)
        return Trajectory(
            np.array(seconds),
            np.array(solver_seconds),
            np.stack(poses),
            self._anchor_rendering,
            self._mask_rendering,
            self._masking,
            self._anchors,
            self._mask_views,
        )


def record_ours(
    renderer: Any,
    photo: Photo,
    start_cam_from_world: Float64Array,
    settings: RefinementSettings,
    metres_per_unit: float | None,
) -> tuple[RefinementResult, Trajectory]:
    """:func:`gscpe.refinement.refine_pose`, followed from iteration to iteration."""
    recorder = Recorder(renderer)
    recorder.reached(start_cam_from_world)
    with _watched(recorder):
        result = refine_pose(
            cast(Renderer, recorder), photo, start_cam_from_world, settings, metres_per_unit
        )
    if result.cam_from_world is not None:
        recorder.reached(result.cam_from_world)
    return result, recorder.trajectory()


@contextmanager
def _watched(recorder: Recorder) -> Iterator[None]:
    """Every iteration warps the template once: there the recorder learns the pose. The mask
    goes through it too."""
    warp: Callable[..., Any] = lucas_kanade.warp

    def watched_warp(points: Any, photo_from_anchor: Float64Array, camera: Camera) -> Any:
        recorder.reached_from_anchor(photo_from_anchor)
        return warp(points, photo_from_anchor, camera)

    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(lucas_kanade, "warp", watched_warp))
        stack.enter_context(mock.patch.object(loop, "visibility_mask", recorder.visibility_mask))
        yield
