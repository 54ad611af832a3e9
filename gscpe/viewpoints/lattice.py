# SPDX-License-Identifier: Apache-2.0
"""The points of free space that viewpoints are chosen from: a lattice."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import BoolArray, Float64Array
from gscpe.errors import MapError
from gscpe.splats import GaussianScene
from gscpe.viewpoints.axes import solid
from gscpe.viewpoints.settings import ViewpointSettings
from gscpe.viewpoints.space import Space

INSTEAD = "build the map with photos and their poses (--colmap, --images), or with --no-references"
"""What else can be done where there are no viewpoints."""

_LEAST_ENCLOSURE = 0.12
_MOST_POINTS = 6000


def lattice_spacing(space: Space, settings: ViewpointSettings) -> float:
    """World units between neighbouring places."""
    return settings.spacing * space.breadth


def free_points(space: Space, settings: ViewpointSettings) -> tuple[Float64Array, Float64Array]:
    """Points of a lattice in free space, (N, 3) along the main axes, and their enclosure, (N,).

    Raises:
        MapError: there are none.
    """
    spacing = lattice_spacing(space, settings)
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
            + INSTEAD
        )
    return points[free], enclosure


def points_between(
    good: Float64Array, points: Float64Array, space: Space, settings: ViewpointSettings
) -> Float64Array:
    """Points half a step of the lattice from good ones, (M, 3) along the main axes.

    Args:
        good: (N, 3), good points of the lattice.
        points: (P, 3), all of its points in free space.
        space: the occupancy.
        settings: half of their clearance is enough here, where views have been found good.
    """
    half = 0.5 * lattice_spacing(space, settings)
    steps = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = np.rint((good[:, None] + half * steps - space.corner) / half).astype(int)
    added = space.corner + half * np.unique(cells.reshape(-1, 3), axis=0)
    known = {tuple(cell) for cell in np.rint((points - space.corner) / half).astype(int)}
    new = [tuple(cell) not in known for cell in np.rint((added - space.corner) / half).astype(int)]
    added = added[np.array(new, dtype=bool)]
    return np.asarray(added[space.clearance(added) >= settings.clearance * half])


def usual_heights(heights: Float64Array, scene: GaussianScene, up: Float64Array) -> BoolArray:
    """Which of some heights, (N,), cameras are carried at: near the median of what there is, not
    on the floor and not high above.

    Args:
        heights: along up.
        scene: the splat.
        up: (3,) unit vector, in the splat's frame.
    """
    low, middle = np.quantile(scene.means[solid(scene)].astype(np.float64) @ up, (0.05, 0.5))
    return np.asarray(
        (heights >= middle - 0.8 * (middle - low)) & (heights <= middle + 2.0 * (middle - low))
    )
