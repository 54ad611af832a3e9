# SPDX-License-Identifier: Apache-2.0
"""Gauss-Newton on reprojection errors, with robust weights: of a pose, or of a pose and its
camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import BoolArray, Float64Array, IntArray
from gscpe.geometry.camera import Camera
from gscpe.geometry.intrinsics import RADIAL, changed_camera, moved_by_intrinsics

BEHIND = 1e-6
"""Depth in the camera frame, in map units: what is not farther is not seen."""


@dataclass(frozen=True, eq=False)
class Equations:
    """Of one step, in K matches that are near.

    Attributes:
        hessian: (U, U), ``sum w J^T J``; the unknowns are xi in ``exp(xi) @ cam_from_world``, and
            where the camera is sought too, the five of :mod:`gscpe.geometry.intrinsics`.
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

    def projected(
        self, cam_from_world: Float64Array, change: Float64Array | None = None
    ) -> Projected:
        """From a pose, (4, 4), with a changed camera, (5,); see
        :func:`gscpe.geometry.intrinsics.changed_camera`."""
        points = cam_from_world[:3, :3] @ self._points + cam_from_world[:3, 3, None]
        ahead = points[2] > BEHIND
        slopes = points[:2] / np.where(ahead, points[2], 1.0)
        camera = self._camera
        if change is not None:
            camera = changed_camera(camera, change)
            slopes = slopes * (1.0 + change[RADIAL] * np.sum(slopes**2, axis=0))
        errors = self._pixels - np.stack(
            [slopes[0] * camera.fx + camera.cx, slopes[1] * camera.fy + camera.cy]
        )
        squared = np.where(ahead, errors[0] ** 2 + errors[1] ** 2, np.inf)
        return Projected(points, errors, squared)

    def equations(
        self,
        cam_from_world: Float64Array,
        within_pixels: float,
        noise_pixels: float,
        fewest: int,
        change: Float64Array | None = None,
    ) -> Equations | None:
        """Of a step from a pose, (4, 4); None where too few matches are near.

        Args:
            cam_from_world: the pose.
            within_pixels: reprojection error beyond which a match is not near.
            noise_pixels: scale of the Cauchy weights.
            fewest: near matches that are needed.
            change: (5,) of the camera, where it is sought, too.
        """
        seen = self.projected(cam_from_world, change)
        near = np.flatnonzero(seen.within(within_pixels))
        if len(near) < fewest:
            return None
        points, errors, squared = seen.points[:, near], seen.errors[:, near], seen.squared[near]
        cells = self._cells[near]
        weights = 1.0 / ((1.0 + squared / noise_pixels**2) * np.bincount(cells)[cells])
        jacobian = _jacobian(self._camera, points, change).reshape(-1, 2 * len(near))
        weighted = jacobian * np.tile(weights, 2)
        return Equations(weighted @ jacobian.T, weighted @ errors.ravel(), weights, squared)


def _jacobian(camera: Camera, points: Float64Array, change: Float64Array | None) -> Float64Array:
    """d pixel / d unknown, (U, 2, K): as :func:`gscpe.geometry.projection.pose_jacobian`, and by
    a further change of the camera where one is given; laid out so that products are fast."""
    x, y = points[:2] / points[2]
    nearness = 1.0 / points[2]
    jacobian = np.zeros((6 if change is None else 11, 2, len(x)))
    jacobian[0, 0] = jacobian[1, 1] = nearness
    jacobian[2] = -x * nearness, -y * nearness
    jacobian[3] = -x * y, -y * y - 1.0
    jacobian[4] = x * x + 1.0, x * y
    jacobian[5] = -y, x
    seen_by = camera
    if change is not None:
        seen_by, k1 = changed_camera(camera, change), change[RADIAL]
        radial = 1.0 + k1 * (x * x + y * y)
        outwards = jacobian[:6, 0] * x + jacobian[:6, 1] * y
        jacobian[:6] *= radial
        jacobian[:6, 0] += 2.0 * k1 * x * outwards
        jacobian[:6, 1] += 2.0 * k1 * y * outwards
        jacobian[6:] = moved_by_intrinsics(x, y)
        jacobian[6:8] *= radial
        jacobian[8, 0] *= camera.fx / seen_by.fx  # the principal point moves by old ones
        jacobian[9, 1] *= camera.fy / seen_by.fy
    jacobian[:, 0] *= seen_by.fx
    jacobian[:, 1] *= seen_by.fy
    return jacobian


def _cell_numbers(pixels: Float64Array, camera: Camera, cells: int) -> IntArray:
    """A number for each pixel's cell, (N,); no larger than there are cells with pixels."""
    column, row = np.floor(pixels * (cells / camera.width)).astype(np.int64).T
    # Columns differ by less than that: matches lie in the photo.
    number: IntArray = np.unique(row * (4 * cells) + column, return_inverse=True)[1]
    return number
