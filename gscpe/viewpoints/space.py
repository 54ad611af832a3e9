# SPDX-License-Identifier: Apache-2.0
"""Free space: where no Gaussians are, and how much of the splat is around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import BoolArray, Float64Array
from gscpe.errors import MapError
from gscpe.geometry.spread import even_directions
from gscpe.splats import GaussianScene
from gscpe.viewpoints.axes import solid

_CORE = (0.05, 0.95)
"""Quantiles of the solid Gaussians' coordinates between which the scene's core lies."""
_BEYOND = 0.75
"""Times the core's middle extent that is looked at around it: cameras stand outside too."""
_CELLS = 96
"""Of the grid, along its longest side."""
_LAYERS = 0.3
"""Optical thickness of a cell from which on it is occupied."""
_RAYS = 96
_SAMPLES = 5
"""Points an axis that stand for a Gaussian larger than a cell."""


@dataclass(frozen=True, eq=False)
class Space:
    """An occupancy grid of a splat's core and what is around it, along the main axes.

    Attributes:
        axes: (3, 3) rotation, the main axes in its columns.
        low, high: (3,), the core, coordinates along the axes.
        corner: (3,), of the grid.
        cell: side of a cell, world units.
        occupied: (X, Y, Z).
        distance: (X, Y, Z) to the next occupied cell, world units.
    """

    axes: Float64Array
    low: Float64Array
    high: Float64Array
    corner: Float64Array
    cell: float
    occupied: BoolArray
    distance: Float64Array

    @property
    def breadth(self) -> float:
        """The least extent of the core, or a quarter of the middle one where it is flat."""
        extent = self.high - self.low
        return max(float(extent.min()), 0.25 * float(np.median(extent)))

    @classmethod
    def of(cls, scene: GaussianScene, axes: Float64Array) -> Space:
        """Of the Gaussians, coordinates relative to the scene's origin.

        A cell's optical thickness is the sum of opacity times area over the Gaussians in it,
        divided by the area of its side.

        Raises:
            MapError: the splat has no extent.
        """
        rows = np.flatnonzero(solid(scene))
        points = scene.means[rows].astype(np.float64) @ axes
        low, high = np.quantile(points, _CORE, axis=0)
        beyond = _BEYOND * float(np.median(high - low))
        if not beyond > 0:
            raise MapError("no viewpoint can be found: all Gaussians of the splat stand in a line")
        corner = low - beyond
        cell = float((high - low + 2 * beyond).max()) / _CELLS
        shape = np.ceil((high - low + 2 * beyond) / cell).astype(int)
        thickness = np.zeros(shape)
        for at, weight in _spread_out(scene.taken(rows), axes, cell):
            index = np.floor((at - corner) / cell).astype(int)
            inside = np.all((index >= 0) & (index < shape), axis=1)
            np.add.at(thickness, tuple(index[inside].T), weight[inside] / cell**2)
        occupied = thickness >= _LAYERS
        if not np.any(occupied):
            raise MapError("no viewpoint can be found: the splat has no surfaces, only haze")
        from scipy.ndimage import distance_transform_edt

        distance = np.asarray(distance_transform_edt(~occupied, sampling=cell))
        return cls(axes, low, high, corner, cell, occupied, distance)

    def clearance(self, points: Float64Array) -> Float64Array:
        """Distance of points, (N, 3) along the axes, to what is occupied, world units."""
        index = np.floor((points - self.corner) / self.cell).astype(int)
        index = np.clip(index, 0, np.array(self.occupied.shape) - 1)
        return np.asarray(self.distance[tuple(index.T)])

    def enclosure(self, points: Float64Array) -> Float64Array:
        """Share of all directions, (N,), in which something is met from points, (N, 3)."""
        rays = even_directions(_RAYS)
        at = np.repeat(points, len(rays), axis=0)
        rays = np.tile(rays, (len(points), 1))
        hit = np.zeros(len(at), dtype=bool)
        going = np.arange(len(at))
        end = self.corner + self.cell * np.array(self.occupied.shape)
        for _ in range(4 * _CELLS):
            free = self.clearance(at[going])
            hit[going[free <= 0]] = True
            at[going] += rays[going] * np.maximum(free, 0.5 * self.cell)[:, None]
            inside = np.all((at[going] > self.corner) & (at[going] < end), axis=1)
            going = going[(free > 0) & inside]
            if not len(going):
                break
        return np.asarray(hit.reshape(len(points), -1).mean(axis=1))


def _spread_out(
    scene: GaussianScene, axes: Float64Array, cell: float
) -> list[tuple[Float64Array, Float64Array]]:
    """Points along the main axes, and the area that each covers: centres, and of Gaussians that
    are larger than a cell some more along their two longer axes."""
    order = np.argsort(scene.scales, axis=1)[:, ::-1]
    scales = np.take_along_axis(scene.scales, order, axis=1).astype(np.float64)
    area = 2.0 * np.pi * scales[:, 0] * scales[:, 1] * scene.opacities
    centres = scene.means.astype(np.float64) @ axes
    small = scales[:, 0] <= 0.5 * cell
    parts = [(centres[small], area[small])]
    large = np.flatnonzero(~small)
    if len(large):
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_quat(scene.quaternions[large], scalar_first=True).as_matrix()
        first, second = (
            np.take_along_axis(turned, order[large, None, k : k + 1], axis=2)[:, :, 0]
            @ axes
            * scales[large, k, None]
            for k in (0, 1)
        )
        steps = np.linspace(-1.5, 1.5, _SAMPLES)
        for a in steps:
            for b in steps:
                weight = np.exp(-0.5 * (a * a + b * b))
                parts.append((centres[large] + a * first + b * second, weight * area[large]))
        total = sum(np.exp(-0.5 * (a * a + b * b)) for a in steps for b in steps)
        parts[1:] = [(at, weight / total) for at, weight in parts[1:]]
    return parts
