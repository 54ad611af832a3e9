# SPDX-License-Identifier: Apache-2.0
"""Places in free space from which a splat looks as its photos did.

Some points of the lattice, spread over it, are looked from in the six directions of the main axes;
then more of them, first those whose nearest known place is good and far away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Iterable, Sequence, TypeVar

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array, IntArray
from gscpe.errors import MapError
from gscpe.geometry.camera import Camera
from gscpe.geometry.spread import farthest_first
from gscpe.render import Renderer
from gscpe.splats import GaussianScene
from gscpe.viewpoints.lattice import (
    INSTEAD,
    free_points,
    lattice_spacing,
    points_between,
    usual_heights,
)
from gscpe.viewpoints.quality import distance_penalty, is_usable, view_quality
from gscpe.viewpoints.settings import ViewpointSettings
from gscpe.viewpoints.space import Space

_T = TypeVar("_T")

_SIDE = 96
"""Pixels of the small renders, 90 degrees wide."""
_PREVIEW = 160
"""Pixels of the longer side of a preview of a view."""
_ROOM, _OUTSIDE = 0.8, 0.5
"""Where a good place sees something in this share of all directions, the splat is a closed room,
and places that see less than this are outside of it."""
FIFTH = 4
"""Scores are compared with that of the fifth best place: the very best may be an exception."""
_ENCLOSED = 0.3
"""Score for being e times as enclosed: photos of a building's outside are taken in the open."""
_CURIOSITY = 0.75
"""Score that is made up for by being e times as far from the nearest known place."""
NOTHING = (
    "no viewpoint can be found: from nowhere in the free space does the splat show surfaces; "
    + INSTEAD
)
OUT_OF_SIGHT = -1e9

FACES = ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1))
"""The six directions: main axis, and sign."""


@dataclass(frozen=True, eq=False)
class Place:
    """A point in free space, and what is seen from it.

    Attributes:
        point: (3,), coordinates along the main axes.
        enclosure: share of all directions in which something is met.
        scores: (6,) of the views along :data:`FACES`, -1e9 for those that show too little.
    """

    point: Float64Array
    enclosure: float
    scores: Float64Array

    @property
    def best(self) -> float:
        """The score of its best view."""
        return float(self.scores.max())


class PlaceSearch:
    """Looks at a splat from places in its free space.

    Args:
        scene: coordinates relative to its origin are meant in all of this.
        space: its occupancy, along the main axes.
        settings: see there.
        backend, progress: as :class:`gscpe.Renderer`.

    Raises:
        MapError: there is no free space from which the splat is seen.
    """

    def __init__(
        self,
        scene: GaussianScene,
        space: Space,
        settings: ViewpointSettings,
        backend: str = "auto",
        progress: bool = False,
    ) -> None:
        self._scene, self._space, self._settings = scene, space, settings
        self._backend, self._progress = backend, progress
        self._spacing = lattice_spacing(space, settings)
        self._points, self._enclosure = free_points(space, settings)
        self._tried: dict[int, Place] = {}

    def spread_out(self) -> list[Place]:
        """Places far from each other, looked from in all six directions.

        Raises:
            MapError: none of them shows surfaces.
        """
        chosen = farthest_first(self._points, self._settings.seeds, self._enclosure)
        self._look(chosen, FACES, "looking around")
        places = list(self._tried.values())
        if max(place.best for place in places) <= OUT_OF_SIGHT / 2:
            raise MapError(NOTHING)
        return places

    def good(self, up: Float64Array) -> list[Place]:
        """The places with good level views, best first, of these, of more where they are good,
        and of others between those.

        The next place that is tried is one whose nearest known place is good, and far away.

        Args:
            up: (3,), one of the main axes or its opposite.

        Raises:
            MapError: no level view shows surfaces.
        """
        height = self._space.axes.T @ up
        vertical = int(np.argmax(np.abs(height)))
        level = tuple(face for face in FACES if face[0] != vertical)
        usual = np.flatnonzero(
            usual_heights(self._points @ height, self._scene, self._space.axes @ height)
        )
        for index, place in self._tried.items():
            self._tried[index] = replace(place, scores=_level(place.scores, vertical))
        if not len(usual):
            raise MapError(NOTHING)
        self._grow(usual, level, self._settings.grown, "looking closer")
        between = self._between([int(k) for k in usual if int(k) in self._tried], height)
        self._grow(between, level, self._settings.between, "looking between")
        known = {*usual.tolist(), *between.tolist()}
        return _good([p for k, p in self._tried.items() if k in known], self._settings)

    def rated(self, cam_from_scene: Float64Array, what: str) -> Float64Array:
        """Scores, (N,), of (N, 4, 4) poses by small renders of the views themselves; -1e9 where one
        does not show enough, or something too near.

        Args:
            cam_from_scene: the poses.
            what: shown beside the bar.
        """
        camera = self._settings.camera
        longest = max(camera.width, camera.height)
        scale = min(1.0, _PREVIEW / longest)
        small = camera.resized(
            max(1, round(scale * camera.width)), max(1, round(scale * camera.height))
        )
        with Renderer(*self._renderer()) as renderer:
            return np.array(
                [
                    _rated(renderer, small, pose, self._space, self._settings)
                    for pose in self._bar(cam_from_scene, what, "view")
                ]
            )

    def _between(self, known: Sequence[int], height: Float64Array) -> IntArray:
        """Adds points half a step from good places, where cameras may be nearer to surfaces than
        the lattice allows; indices of those at heights that cameras are carried at."""
        good = _good([self._tried[k] for k in known], self._settings)
        added = points_between(
            np.array([place.point for place in good]), self._points, self._space, self._settings
        )
        added = added[usual_heights(added @ height, self._scene, self._space.axes @ height)]
        first = len(self._points)
        self._points = np.concatenate([self._points, added])
        self._enclosure = np.concatenate([self._enclosure, self._space.enclosure(added)])
        return np.arange(first, len(self._points))

    def _grow(
        self, allowed: IntArray, level: tuple[tuple[int, int], ...], most: int, what: str
    ) -> None:
        """Looks from more of the allowed points."""
        if not len(allowed):
            return
        tried = list(self._tried)
        far = np.linalg.norm(self._points[allowed, None] - self._points[None, tried], axis=2)
        nearest, score = far.min(axis=1), np.array([self._tried[k].best for k in tried])
        expected = score[far.argmin(axis=1)]
        with Renderer(*self._renderer()) as renderer:
            for _ in self._bar(range(min(most, len(allowed))), what):
                with np.errstate(divide="ignore"):
                    worth = expected + _CURIOSITY * np.log(nearest / self._spacing)
                index = int(allowed[int(np.argmax(worth))])
                if index in self._tried:
                    break
                self._tried[index] = place = self._from(renderer, index, level)
                distance = np.linalg.norm(self._points[allowed] - self._points[index], axis=1)
                expected = np.where(distance < nearest, place.best, expected)
                nearest = np.minimum(distance, nearest)

    def _look(self, indices: list[int], faces: tuple[tuple[int, int], ...], what: str) -> None:
        with Renderer(*self._renderer()) as renderer:
            for index in self._bar(indices, what):
                self._tried[index] = self._from(renderer, index, faces)

    def _renderer(self) -> tuple[GaussianScene, str, bool]:
        near = 0.25 * self._settings.clearance * self._spacing
        return replace(self._scene, near=near, origin=np.zeros(3)), self._backend, self._progress

    def _bar(self, items: Iterable[_T], what: str, unit: str = "place") -> Iterable[_T]:
        bar: Iterable[_T] = tqdm(items, desc=what, unit=unit, disable=not self._progress)
        return bar

    def _from(self, renderer: Renderer, index: int, faces: tuple[tuple[int, int], ...]) -> Place:
        point, enclosure = self._points[index], float(self._enclosure[index])
        scores = np.full(len(FACES), OUT_OF_SIGHT)
        for axis, sign in faces:
            seen = _score(renderer, self._space, point, axis, sign, self._settings)
            scores[FACES.index((axis, sign))] = seen + _ENCLOSED * np.log(enclosure)
        return Place(point, enclosure, scores)


def _score(
    renderer: Renderer,
    space: Space,
    point: Float64Array,
    axis: int,
    sign: int,
    settings: ViewpointSettings,
) -> float:
    """Of the view from a point along a main axis; -1e9 where it shows too little."""
    forward = sign * np.eye(3)[axis]
    right = np.eye(3)[(axis + 1) % 3]
    rotation = np.stack([right, np.cross(forward, right), forward]) @ space.axes.T
    cam_from_scene = np.eye(4)
    cam_from_scene[:3, :3] = rotation
    cam_from_scene[:3, 3] = -rotation @ (space.axes @ point)
    half = _SIDE / 2
    camera = Camera.pinhole(_SIDE, _SIDE, fx=half, fy=half, cx=half, cy=half)
    return _rated(renderer, camera, cam_from_scene, space, settings)


def _rated(
    renderer: Renderer,
    camera: Camera,
    cam_from_scene: Float64Array,
    space: Space,
    settings: ViewpointSettings,
) -> float:
    quality = view_quality(renderer.render(camera, cam_from_scene))
    if not is_usable(quality, space, settings):
        return OUT_OF_SIGHT
    return quality.score - distance_penalty(quality.depth, space)


def _level(scores: Float64Array, vertical: int) -> Float64Array:
    axes = np.array([axis for axis, _ in FACES])
    return np.where(axes == vertical, OUT_OF_SIGHT, scores)


def _good(places: list[Place], settings: ViewpointSettings) -> list[Place]:
    ranked = sorted(places, key=lambda place: -place.best)
    if not ranked or ranked[0].best <= OUT_OF_SIGHT / 2:
        raise MapError(NOTHING)
    limit = ranked[min(FIFTH, len(ranked) - 1)].best - settings.margin
    good = [p for p in ranked if p.best >= max(limit, OUT_OF_SIGHT / 2)]
    if max(place.enclosure for place in good) >= _ROOM:
        good = [place for place in good if place.enclosure >= _OUTSIDE]
    return good
