# SPDX-License-Identifier: Apache-2.0
"""Gauss-Newton on reprojection errors, with robust weights: of a pose, or of a pose and a focal
length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import BoolArray, Float64Array, IntArray
from gscpe.geometry.camera import Camera

_BEHIND = 1e-6


@dataclass(frozen=True, eq=False)
class Equations:
    """Of one step, in K matches that are near.

    Attributes:
        hessian: (U, U), ``sum w J^T J``; the unknowns are xi in ``exp(xi) @ cam_from_world``, and
            the logarithm of the focal lengths where that is sought, too.
        gradient: (U,), ``sum w J^T r``.
        weights: (K,) Cauchy's, divided by the number of matches in the cell of each.
        squared: (K,) squared reprojection errors, pixels.
    """

    hessian: Float64Array
    gradient: Float64Array
    weights: Float64Array
    squared: Float64Array

    def step(self) -> Float64Array:
        """(U,); directions that the matches do not determine are not moved."""
        scale = np.sqrt(np.maximum(np.diag(self.hessian), 1e-12))
        values, axes = np.linalg.eigh(self.hessian / np.outer(scale, scale))
        known = values > 1e-9 * values[-1]
        values, axes = values[known], axes[:, known]
        return np.asarray(axes @ (axes.T @ (self.gradient / scale) / values) / scale)

    def variance(self) -> float:
        """Weighted mean of the squared errors along one axis, pixels squared."""
        return float(np.sum(self.weights * self.squared) / (2.0 * np.sum(self.weights)))


@dataclass(frozen=True, eq=False)
class Projected:
    """Matches as a camera sees them.

    Attributes:
        points: (3, N) in the camera's frame.
        errors: (2, N) pixels, where they are less where they should be.
        squared: (N,) squared lengths of the errors; infinite behind the camera.
    """

    points: Float64Array
    errors: Float64Array
    squared: Float64Array

    def within(self, pixels: float) -> BoolArray:
        """(N,), whether each is off by less."""
        return np.asarray(self.squared < pixels**2)


class Matches2D3D:
    """Matches of pixels and points of the world, laid out for least squares.

    Args:
        points_world: (N, 3).
        pixels: (N, 2), the centre of the top-left pixel at (0.5, 0.5).
        camera: pinhole camera of the pixels.
        cells: columns of a grid of square cells over the photo; the matches of a cell count as one.
    """

    def __init__(
        self, points_world: Float64Array, pixels: Float64Array, camera: Camera, cells: int
    ) -> None:
        self._points = np.ascontiguousarray(points_world.T)
        self._pixels = np.ascontiguousarray(pixels.T)
        self._camera = camera
        self._cells = _cell_numbers(pixels, camera, cells)

    def projected(self, cam_from_world: Float64Array, zoom: float = 1.0) -> Projected:
        """From a pose, (4, 4), with so many times the camera's focal lengths."""
        camera = self._camera
        points = cam_from_world[:3, :3] @ self._points + cam_from_world[:3, 3, None]
        ahead = points[2] > _BEHIND
        z = np.where(ahead, points[2], 1.0)
        errors = self._pixels - np.stack(
            [
                points[0] * (zoom * camera.fx) / z + camera.cx,
                points[1] * (zoom * camera.fy) / z + camera.cy,
            ]
        )
        squared = np.where(ahead, errors[0] ** 2 + errors[1] ** 2, np.inf)
        return Projected(points, errors, squared)

    def equations(
        self,
        cam_from_world: Float64Array,
        within_pixels: float,
        noise_pixels: float,
        fewest: int,
        zoom: float | None = None,
    ) -> Equations | None:
        """Of a step from a pose, (4, 4); None where too few matches are near.

        Args:
            cam_from_world: the pose.
            within_pixels: reprojection error beyond which a match is not near.
            noise_pixels: scale of the Cauchy weights.
            fewest: near matches that are needed.
            zoom: times the camera's focal lengths, where these are sought, too.
        """
        seen = self.projected(cam_from_world, 1.0 if zoom is None else zoom)
        near = np.flatnonzero(seen.within(within_pixels))
        if len(near) < fewest:
            return None
        (x, y, z), errors, squared = seen.points[:, near], seen.errors[:, near], seen.squared[near]
        cells = self._cells[near]
        weights = 1.0 / ((1.0 + squared / noise_pixels**2) * np.bincount(cells)[cells])
        jacobian = _jacobian(self._camera, x, y, z, zoom).reshape(-1, 2 * len(near))
        weighted = jacobian * np.tile(weights, 2)
        return Equations(weighted @ jacobian.T, weighted @ errors.ravel(), weights, squared)


def _jacobian(
    camera: Camera, x: Float64Array, y: Float64Array, z: Float64Array, zoom: float | None
) -> Float64Array:
    """d pixel / d unknown, (U, 2, K): as :func:`gscpe.geometry.projection.pose_jacobian`, and by
    the logarithm of the focal lengths where a zoom is given; laid out so that products are fast."""
    fx, fy = (focal * (1.0 if zoom is None else zoom) for focal in (camera.fx, camera.fy))
    slope_x, slope_y = x / z, y / z
    u, v = fx * slope_x, fy * slope_y
    jacobian = np.empty((6 if zoom is None else 7, 2, len(x)))
    by_x, by_y, by_z, turn_x, turn_y, turn_z = jacobian[:6]
    by_x[0], by_x[1] = fx / z, 0.0
    by_y[0], by_y[1] = 0.0, fy / z
    by_z[0], by_z[1] = -u / z, -v / z
    turn_x[0], turn_x[1] = -u * slope_y, -v * slope_y - fy
    turn_y[0], turn_y[1] = u * slope_x + fx, v * slope_x
    turn_z[0], turn_z[1] = -fx * slope_y, fy * slope_x
    if zoom is not None:
        jacobian[6, 0], jacobian[6, 1] = u, v
    return jacobian


def _cell_numbers(pixels: Float64Array, camera: Camera, cells: int) -> IntArray:
    """A number for each pixel's cell, (N,); no larger than there are cells with pixels."""
    column, row = np.floor(pixels * (cells / camera.width)).astype(np.int64).T
    # Columns differ by less than that: matches lie in the photo.
    number: IntArray = np.unique(row * (4 * cells) + column, return_inverse=True)[1]
    return number
