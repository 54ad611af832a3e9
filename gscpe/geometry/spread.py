# SPDX-License-Identifier: Apache-2.0
"""Directions, and choices among many things, spread evenly; how far pixels are spread."""

from __future__ import annotations

from typing import Sequence, TypeVar

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.camera import Camera

_T = TypeVar("_T")


def even_directions(count: int) -> Float64Array:
    """Unit vectors, (count, 3), evenly over the sphere: a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def farthest_first(
    points: Float64Array, count: int, weights: Float64Array | None = None
) -> list[int]:
    """Indices of points far from each other: again and again the one that is farthest from those
    before it (Gonzalez, 1985).

    Args:
        points: (N, D), N at least 1.
        count: how many at most; fewer where others stand in the same places.
        weights: (N,) of the distances; the first point is the one with the most weight, or else
            the first one.
    """
    weights = np.ones(len(points)) if weights is None else weights
    chosen = [int(np.argmax(weights))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        worth = distance * weights
        farthest = int(np.argmax(worth))
        if not worth[farthest] > 0:
            break
        chosen.append(farthest)
        distance = np.minimum(distance, np.linalg.norm(points - points[farthest], axis=1))
    return chosen


def evenly_spread(count: int, most: int) -> list[int]:
    """At most so many different indices of ``count`` things, in order; the first and the last are
    among them, or the first alone where only one is wanted."""
    return [int(i) for i in np.rint(np.linspace(0, count - 1, min(count, most)))]


def thinned(items: Sequence[_T], most: int) -> list[_T]:
    """At most so many of them, evenly spread, as :func:`evenly_spread` chooses."""
    return [items[i] for i in evenly_spread(len(items), most)]


def spread_over_image(pixels: Float64Array, camera: Camera) -> float:
    """Share of a 4x4 grid over the image, in [0, 1], whose cells hold at least one of the
    pixels, (N, 2); those outside count for the nearest cell."""
    columns = np.clip(4.0 * pixels[:, 0] / camera.width, 0, 3).astype(int)
    rows = np.clip(4.0 * pixels[:, 1] / camera.height, 0, 3).astype(int)
    return len(set(zip(rows.tolist(), columns.tolist(), strict=True))) / 16.0
