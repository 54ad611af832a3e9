# SPDX-License-Identifier: Apache-2.0
"""Pinhole projection and its derivatives.

Pixels are (u, v), the centre of the top-left pixel at (0.5, 0.5); points are in the
camera frame, z forward; depth is z.
"""

from __future__ import annotations

import numpy as np

from gscpe.arrays import Float32Array, Float64Array, IntArray
from gscpe.geometry.camera import Camera


def transform_points(b_from_a: Float64Array, points_in_a: Float64Array) -> Float64Array:
    """Points of frame a, (N, 3), in frame b, (N, 3)."""
    return np.asarray(points_in_a @ b_from_a[:3, :3].T + b_from_a[:3, 3])


def project(camera: Camera, points_in_cam: Float64Array) -> Float64Array:
    """Pixels, (N, 2), of points in the camera frame, (N, 3), which must have z > 0."""
    z = points_in_cam[:, 2]
    u = camera.fx * points_in_cam[:, 0] / z + camera.cx
    v = camera.fy * points_in_cam[:, 1] / z + camera.cy
    return np.stack([u, v], axis=1)


def unproject(camera: Camera, pixels: Float64Array, depth: Float64Array) -> Float64Array:
    """Points in the camera frame, (N, 3), of pixels, (N, 2), with z-depth, (N,)."""
    x = (pixels[:, 0] - camera.cx) / camera.fx * depth
    y = (pixels[:, 1] - camera.cy) / camera.fy * depth
    return np.stack([x, y, depth], axis=1)


def unproject_image(
    camera: Camera, depth: Float32Array, indices: IntArray | None = None
) -> Float32Array:
    """Points in the camera frame, (3, N) float32, of the pixels of a z-depth image, (H, W).

    Args:
        camera: of the image.
        depth: (H, W) float32.
        indices: (N,) flat indices of pixels; None for all of them, row by row.
    """
    if indices is None:
        indices = np.arange(depth.size)
    row, column = np.divmod(indices, camera.width)
    z = depth.ravel()[indices]
    x = (column.astype(np.float32) + np.float32(0.5 - camera.cx)) / np.float32(camera.fx) * z
    y = (row.astype(np.float32) + np.float32(0.5 - camera.cy)) / np.float32(camera.fy) * z
    return np.stack([x, y, z])


def pixel_centres(camera: Camera) -> Float64Array:
    """All pixel centres, (height, width, 2): (0.5, 0.5), (1.5, 0.5), ..."""
    u = np.arange(camera.width) + 0.5
    v = np.arange(camera.height) + 0.5
    return np.stack(np.meshgrid(u, v), axis=-1)


def projection_jacobian(camera: Camera, points_in_cam: Float64Array) -> Float64Array:
    """d pixel / d point, (N, 2, 3), at points in the camera frame, (N, 3)."""
    x, y, z = points_in_cam.T
    jacobian = np.zeros((len(points_in_cam), 2, 3))
    jacobian[:, 0, 0] = camera.fx / z
    jacobian[:, 0, 2] = -camera.fx * x / z**2
    jacobian[:, 1, 1] = camera.fy / z
    jacobian[:, 1, 2] = -camera.fy * y / z**2
    return jacobian


def pose_jacobian(camera: Camera, points_in_cam: Float64Array) -> Float64Array:
    """d pixel / d xi, (N, 2, 6), at xi = 0 of ``project(exp(xi) @ points_in_cam)``.

    ``d(exp(xi) X)/d xi = [I | -[X]x]``, written out column by column.
    """
    by_point = projection_jacobian(camera, points_in_cam)
    x, y, z = (points_in_cam[:, i, None] for i in range(3))
    jacobian = np.empty((len(points_in_cam), 2, 6))
    jacobian[:, :, :3] = by_point
    jacobian[:, :, 3] = by_point[:, :, 2] * y - by_point[:, :, 1] * z
    jacobian[:, :, 4] = by_point[:, :, 0] * z - by_point[:, :, 2] * x
    jacobian[:, :, 5] = by_point[:, :, 1] * x - by_point[:, :, 0] * y
    return jacobian
