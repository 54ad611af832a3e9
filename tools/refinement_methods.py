# SPDX-License-Identifier: Apache-2.0
"""Ways to refine a pose, followed through time, and starts to refine from."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Callable, Sequence

import numpy as np
from _common import Case, Error, error_of, progress
from adam_baseline import AdamSettings, refine_by_adam

from gscpe import Camera, LocalizationResult, Localizer
from gscpe.arrays import BoolArray, Float64Array
from gscpe.geometry import se3
from gscpe.photos import Photo
from gscpe.refinement import RefinementObserver, RefinementSettings, refine_pose
from gscpe.render import RenderedView, Renders


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A pose on its way; the first entry is the start, the last what was found.

    Attributes:
        seconds: (T,) since the start, all included.
        solver_seconds: (T,) the same without renders and masks.
        cam_from_world: (T, 4, 4).
    """

    seconds: Float64Array
    solver_seconds: Float64Array
    cam_from_world: Float64Array


class Recorder(RefinementObserver):
    """Follows a refinement that renders by it and tells it what it does."""

    def __init__(self, renderer: Renders, start_cam_from_world: Float64Array) -> None:
        self._renderer = renderer
        self._begin = time.perf_counter()
        self._not_solving = 0.0
        self._mask_begins: float | None = None
        self._anchor = start_cam_from_world
        self._points: list[tuple[float, float, Float64Array]] = []
        self.reached(start_cam_from_world)

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        begin = time.perf_counter()
        view = self._renderer.render(camera, cam_from_world)
        if self._mask_begins is None:  # else it is counted with the mask
            self._not_solving += time.perf_counter() - begin
        return view

    def anchor_rendered(self, view: RenderedView) -> None:
        self._anchor = view.cam_from_world
        self._mask_begins = time.perf_counter()

    def mask_made(self, mask: BoolArray) -> None:
        assert self._mask_begins is not None
        self._not_solving += time.perf_counter() - self._mask_begins
        self._mask_begins = None

    def iterated(self, photo_from_anchor: Float64Array) -> None:
        self.reached(photo_from_anchor @ self._anchor)

    def reached(self, cam_from_world: Float64Array) -> None:
        seconds = time.perf_counter() - self._begin
        self._points.append((seconds, seconds - self._not_solving, cam_from_world.copy()))

    def trajectory(self) -> Trajectory:
        seconds, solver_seconds, poses = zip(*self._points, strict=True)
        return Trajectory(np.array(seconds), np.array(solver_seconds), np.stack(poses))


Refine = Callable[[Renders, Photo, Float64Array, Recorder], Float64Array | None]
"""From renderer, photo, start and recorder to the pose, None where none is found."""


@dataclass(frozen=True)
class Method:
    """A way to refine, by name."""

    name: str
    refine: Refine

    def run(
        self,
        renderer: Renders,
        photo: Photo,
        start_cam_from_world: Float64Array,
    ) -> Trajectory | None:
        """None where no pose was found."""
        recorder = Recorder(renderer, start_cam_from_world)
        found = self.refine(recorder, photo, start_cam_from_world, recorder)
        if found is None:
            return None
        recorder.reached(found)
        return recorder.trajectory()


def lucas_kanade(settings: RefinementSettings, name: str = "Lucas-Kanade") -> Method:
    """gscpe's."""

    def refine(
        renderer: Renders,
        photo: Photo,
        start: Float64Array,
        recorder: Recorder,
    ) -> Float64Array | None:
        return refine_pose(renderer, photo, start, settings, recorder).cam_from_world

    return Method(name, refine)


def adam(settings: AdamSettings, name: str = "Adam") -> Method:
    """The paper's."""

    def refine(
        renderer: Renders,
        photo: Photo,
        start: Float64Array,
        recorder: Recorder,
    ) -> Float64Array | None:
        return refine_by_adam(renderer, photo, start, settings, recorder)

    return Method(name, refine)


@dataclass(frozen=True, eq=False)
class Start:
    """A query, and where its refinement begins."""

    case: Case
    cam_from_world: Float64Array

    def run(self, localizer: Localizer, method: Method) -> Trajectory | None:
        photo = self.case.photo_in(localizer)
        return method.run(localizer, photo, self.cam_from_world)

    def error(self, localizer: Localizer, cam_from_world: Float64Array | None) -> Error:
        return error_of(cam_from_world, self.case.truth, localizer.map.metres_per_unit or 1.0)


def displaced(
    cam_from_world: Float64Array, distance: float, degrees: float, rng: np.random.Generator
) -> Float64Array:
    """The camera moved by exactly so many map units and turned by exactly so many degrees,
    both in directions drawn at random, uniformly."""
    shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = se3.exp(np.concatenate([np.zeros(3), np.radians(degrees) * axis]))
    moved = turn @ cam_from_world
    moved[:3, 3] += distance * shift
    return np.asarray(moved)


def coarse_starts(
    localizer: Localizer, cases: Sequence[Case]
) -> list[tuple[Start, LocalizationResult]]:
    """The coarse poses, and the results that they are of; queries without one are named."""
    found = []
    for case in progress(cases, "localize"):
        result = localizer.localize(case.image, case.query.camera)
        if result.coarse is None or result.coarse.cam_from_world is None:
            print(f"left out, no coarse pose: {case.query.name}")
            continue
        found.append((Start(case, result.coarse.cam_from_world), result))
    return found
