# SPDX-License-Identifier: Apache-2.0
"""Places in free space from which a splat looks as its photos did.

A lattice of points covers the free space. Some, spread over it, are looked at in the six
directions of the main axes; then the neighbours of the best, as long as they are good too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Iterable, TypeVar

import numpy as np
from tqdm import tqdm

from gscpe.arrays import BoolArray, Float64Array, IntArray
from gscpe.errors import MapError
from gscpe.geometry.camera import Camera
from gscpe.render import Renderer
from gscpe.splats import GaussianScene
from gscpe.viewpoints.axes import solid
from gscpe.viewpoints.quality import ViewQuality, view_quality
from gscpe.viewpoints.settings import ViewpointSettings
from gscpe.viewpoints.space import Space

_T = TypeVar("_T")

_SIDE = 96
"""Pixels of the small renders, 90 degrees wide."""
_PREVIEW = 160
"""Pixels of the longer side of a preview of a view."""
_LEAST_ENCLOSURE = 0.12
_ROOM, _OUTSIDE = 0.8, 0.5
"""Where a good place sees something in this share of all directions, the splat is a closed room,
and places that see less than this are outside of it."""
_MOST_POINTS = 6000
_BEST = 4
"""Scores are compared with that of the fifth best place: the very best may be an exception."""
_CURIOSITY = 0.75
_INSTEAD = "build the map with photos and their poses (--colmap, --images), or with --no-references"
_NOTHING = (
    "no viewpoint can be found: from nowhere in the free space does the splat show surfaces; "
    + _INSTEAD
)
_OUT_OF_SIGHT = -1e9

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
        self._points, self._enclosure = _lattice(space, self._spacing, settings)
        self._tried: dict[int, Place] = {}

    def spread_out(self) -> list[Place]:
        """Places far from each other, looked from in all six directions.

        Raises:
            MapError: none of them shows surfaces.
        """
        chosen = _spread(self._points, self._enclosure, self._settings.seeds)
        self._look(chosen, FACES, "looking around")
        places = list(self._tried.values())
        if max(place.best for place in places) <= _OUT_OF_SIGHT / 2:
            raise MapError(_NOTHING)
        return places

    def good(self, up: Float64Array) -> list[Place]:
        """The places with good level views, best first, of these and of more where they are good.

        The next place that is tried is one whose nearest known place is good, and far away.

        Args:
            up: (3,), one of the main axes or its opposite.

        Raises:
            MapError: no level view shows surfaces.
        """
        height = self._space.axes.T @ up
        vertical = int(np.argmax(np.abs(height)))
        level = tuple(face for face in FACES if face[0] != vertical)
        usual = _usual_heights(self._points @ height, self._scene, self._space.axes @ height)
        for index, place in self._tried.items():
            self._tried[index] = replace(place, scores=_level(place.scores, vertical))
        self._grow(np.flatnonzero(usual), level)
        return _good([p for k, p in self._tried.items() if usual[k]], self._settings)

    def usable(self, cam_from_scene: Float64Array) -> Float64Array:
        """Those of (N, 4, 4) poses whose own views show enough, and nothing too near.

        Raises:
            MapError: none does.
        """
        camera = self._settings.camera
        longest = max(camera.width, camera.height)
        scale = min(1.0, _PREVIEW / longest)
        small = camera.resized(
            max(1, round(scale * camera.width)), max(1, round(scale * camera.height))
        )
        with Renderer(*self._renderer()) as renderer:
            kept = [
                pose
                for pose in self._bar(cam_from_scene, "looking at views", "view")
                if is_usable(
                    view_quality(renderer.render(small, pose)), self._space, self._settings
                )
            ]
        if not kept:
            raise MapError(_NOTHING)
        return np.array(kept)

    def _grow(self, allowed: IntArray, level: tuple[tuple[int, int], ...]) -> None:
        if not len(allowed):
            raise MapError(_NOTHING)
        tried = list(self._tried)
        far = np.linalg.norm(self._points[allowed, None] - self._points[None, tried], axis=2)
        nearest, score = far.min(axis=1), np.array([self._tried[k].best for k in tried])
        expected = score[far.argmin(axis=1)]
        with Renderer(*self._renderer()) as renderer:
            for _ in self._bar(range(min(self._settings.grown, len(allowed))), "looking closer"):
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
        scores = np.full(len(FACES), _OUT_OF_SIGHT)
        for axis, sign in faces:
            seen = _score(renderer, self._space, point, axis, sign, self._settings)
            scores[FACES.index((axis, sign))] = seen + np.log(enclosure)
        return Place(point, enclosure, scores)


def lattice_spacing(space: Space, settings: ViewpointSettings) -> float:
    """World units between neighbouring places."""
    extent = space.high - space.low
    return settings.spacing * max(float(extent.min()), 0.25 * float(np.median(extent)))


def _lattice(
    space: Space, spacing: float, settings: ViewpointSettings
) -> tuple[Float64Array, Float64Array]:
    """Points of a lattice in free space, (N, 3) along the main axes, and their enclosure, (N,)."""
    size = space.cell * np.array(space.occupied.shape)
    counts = np.maximum(1, np.floor(size / spacing)).astype(int)
    cells = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    points = space.corner + (cells + 0.5) * spacing
    free = np.flatnonzero(space.clearance(points) >= settings.clearance * spacing)
    if len(free) > _MOST_POINTS:  # those nearest to the core
        middle = np.maximum(space.low - points[free], points[free] - space.high).max(axis=1)
        free = free[np.argsort(middle, kind="stable")[:_MOST_POINTS]]
    if len(free):
        enclosure = space.enclosure(points[free])
        around = enclosure >= _LEAST_ENCLOSURE
        free, enclosure = free[around], enclosure[around]
    if not len(free):
        raise MapError(
            "no viewpoint can be found: the splat leaves no free space from which it is seen; "
            + _INSTEAD
        )
    return points[free], enclosure


def _spread(points: Float64Array, weight: Float64Array, count: int) -> list[int]:
    """Indices of points far from each other, the more enclosed the rather."""
    chosen = [int(np.argmax(weight))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(np.argmax(distance * weight)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        if not np.any(distance > 0):
            break
    return list(dict.fromkeys(chosen))


def _score(
    renderer: Renderer,
    space: Space,
    point: Float64Array,
    axis: int,
    sign: int,
    settings: ViewpointSettings,
) -> float:
    forward = sign * np.eye(3)[axis]
    right = np.eye(3)[(axis + 1) % 3]
    rotation = np.stack([right, np.cross(forward, right), forward]) @ space.axes.T
    cam_from_scene = np.eye(4)
    cam_from_scene[:3, :3] = rotation
    cam_from_scene[:3, 3] = -rotation @ (space.axes @ point)
    half = _SIDE / 2
    camera = Camera.pinhole(_SIDE, _SIDE, fx=half, fy=half, cx=half, cy=half)
    quality = view_quality(renderer.render(camera, cam_from_scene))
    if not is_usable(quality, space, settings):
        return _OUT_OF_SIGHT
    return quality.score - distance_penalty(quality.depth, space)


def is_usable(quality: ViewQuality, space: Space, settings: ViewpointSettings) -> bool:
    """Whether a view shows enough, nothing too near, and surfaces rather than haze."""
    return (
        quality.covered >= settings.min_covered
        and quality.near >= 0.5 * settings.clearance * lattice_spacing(space, settings)
        and quality.thickness <= settings.max_thickness
    )


def distance_penalty(depth: float, space: Space) -> float:
    """What is subtracted from a view's score: from afar, everything looks sharp."""
    extent = space.high - space.low
    usual = 0.5 * max(float(extent.min()), 0.25 * float(np.median(extent)))
    return max(0.0, float(np.log(depth / usual)))


def _usual_heights(heights: Float64Array, scene: GaussianScene, up: Float64Array) -> BoolArray:
    """Which heights cameras are carried at: near the median of what there is, not on the floor
    and not high above."""
    low, middle = np.quantile(scene.means[solid(scene)].astype(np.float64) @ up, (0.05, 0.5))
    return np.asarray(
        (heights >= middle - 0.5 * (middle - low)) & (heights <= middle + 2.0 * (middle - low))
    )


def _level(scores: Float64Array, vertical: int) -> Float64Array:
    axes = np.array([axis for axis, _ in FACES])
    return np.where(axes == vertical, _OUT_OF_SIGHT, scores)


def _good(places: list[Place], settings: ViewpointSettings) -> list[Place]:
    ranked = sorted(places, key=lambda place: -place.best)
    if not ranked or ranked[0].best <= _OUT_OF_SIGHT / 2:
        raise MapError(_NOTHING)
    limit = ranked[min(_BEST, len(ranked) - 1)].best - settings.margin
    good = [p for p in ranked if p.best >= max(limit, _OUT_OF_SIGHT / 2)]
    if max(place.enclosure for place in good) >= _ROOM:
        good = [place for place in good if place.enclosure >= _OUTSIDE]
    return good
