# SPDX-License-Identifier: Apache-2.0
"""Upright views from good places, and how far they look down."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.viewpoints.places import FACES, Place, PlaceSearch
from gscpe.viewpoints.settings import ViewpointSettings
from gscpe.viewpoints.space import Space

_PITCHES = (-20.0, -10.0, 0.0, 10.0, 20.0, 30.0, 40.0)
"""Degrees below the horizon that are tried."""
_USUAL, _UNUSUAL = 10.0, 0.3
"""People look down by so much, mostly; what is subtracted from the score 30 degrees off that."""
_PLACES = 12
"""Places from which the pitches are tried."""
_POOR = -2.0
"""A view is not rated worse than this, relative to the best of its place and direction."""


def views_of(
    places: Sequence[Place],
    space: Space,
    up: Float64Array,
    settings: ViewpointSettings,
    down: float,
) -> Float64Array:
    """World-to-camera poses, (N, 4, 4), relative to the scene's origin: all around each place where
    it is good, ``down`` degrees below the horizon."""
    half = int(np.floor(45.0 / settings.yaw_step))
    yaws = settings.yaw_step * np.arange(-half, half + 1)
    return np.array(
        [
            _looking(space.axes @ point, _turned(level, up, float(yaw), down), up)
            for point, level in _good_directions(places, space)
            for yaw in yaws
        ]
    )


def find_pitch(
    places: Sequence[Place], space: Space, up: Float64Array, search: PlaceSearch
) -> float:
    """Degrees below the horizon at which the splat looks best from good places: there its photos
    looked.

    Training makes sharp and thin what photos saw. From the photos' own places in four splats,
    scores are best 4, 11, 13 and 24 degrees from the photos' median; the last splat looks much the
    same at all pitches.
    """
    directions = _good_directions(places[:_PLACES], space)
    poses = np.array(
        [
            _looking(space.axes @ point, _turned(level, up, 0.0, down), up)
            for point, level in directions
            for down in _PITCHES
        ]
    )
    scores = search.rated(poses, "looking up and down").reshape(len(directions), len(_PITCHES))
    relative = np.maximum(scores - scores.max(axis=1, keepdims=True), _POOR).mean(axis=0)
    unusual = _UNUSUAL * ((np.array(_PITCHES) - _USUAL) / 30.0) ** 2
    return _PITCHES[int(np.argmax(relative - unusual))]


def _good_directions(
    places: Sequence[Place], space: Space
) -> list[tuple[Float64Array, Float64Array]]:
    """Places, and the main axes, level, along which they are as good as the worst of all places in
    its best direction."""
    limit = min(place.best for place in places)
    return [
        (place.point, sign * space.axes[:, axis])
        for place in places
        for (axis, sign), score in zip(FACES, place.scores, strict=True)
        if score >= limit
    ]


def _turned(level: Float64Array, up: Float64Array, yaw: float, down: float) -> Float64Array:
    """A level direction turned about up, then lowered; degrees."""
    yaw, down = np.deg2rad(yaw), np.deg2rad(down)
    turned = np.cos(yaw) * level + np.sin(yaw) * np.cross(up, level)
    return np.asarray(np.cos(down) * turned - np.sin(down) * up)


def _looking(centre: Float64Array, forward: Float64Array, up: Float64Array) -> Float64Array:
    """World to camera, (4, 4), of an upright camera."""
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ centre
    return pose
