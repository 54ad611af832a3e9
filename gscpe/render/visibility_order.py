# SPDX-License-Identifier: Apache-2.0
"""Which Gaussians a camera may see, and in what order. Pure NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array, Float64Array, IntArray
from gscpe.geometry.camera import Camera
from gscpe.render.spatial_chunks import SpatialChunks
from gscpe.render.splatting import LOW_PASS, SlopeLimits, sigmas_in_sight
from gscpe.splats.gaussians import GaussianScene


def view_depths(means_by_axis: Float32Array, cam_from_world: Float64Array) -> Float32Array:
    """z-depth, (N,) float32, of means given as (3, N).

    Written out so that every rasterizer gets the same bits, and so the same order.
    """
    a, b, c = cam_from_world[2, :3].astype(np.float32)
    depths: Float32Array = means_by_axis[0] * a
    depths += means_by_axis[1] * b
    depths += means_by_axis[2] * c
    depths += np.float32(cam_from_world[2, 3])
    return depths


def depth_order(depths: Float32Array, indices: NDArray[np.integer]) -> IntArray:
    """Positions of positive depths, (N,), nearest first; equal ones by their index.

    One sort of integers: the bits of positive floats are ordered as they are.
    """
    keys = depths.view(np.uint32).astype(np.uint64) << np.uint64(32)
    keys |= indices.astype(np.uint64)
    return np.argsort(keys)


class VisibilityOrder:
    """Culls and sorts the Gaussians of one scene for any view."""

    def __init__(self, scene: GaussianScene) -> None:
        self._chunks = SpatialChunks.of(scene)
        self._near = scene.near
        order = self._chunks.order
        self._means = np.ascontiguousarray(scene.means[order].T)
        self._sigmas = sigmas_in_sight(scene.opacities[order])
        self._reach: Float32Array = self._sigmas * scene.scales[order].max(axis=1)

    def back_to_front(self, camera: Camera, cam_from_world: Float64Array) -> NDArray[np.uint32]:
        """Indices of the Gaussians that may touch the image, farthest first, (M,) uint32."""
        rotation = cam_from_world[:3, :3].astype(np.float32)
        translation = cam_from_world[:3, 3].astype(np.float32)
        near_plane = np.float32(self._near)
        seen = self._chunks.positions_in_view(camera, cam_from_world)
        means = self._means[:, seen]
        z = view_depths(means, cam_from_world)
        inverse_z = 1.0 / np.where(z > near_plane, z, 1.0).astype(np.float32)
        stretch = np.float32(max(camera.fx, camera.fy) * SlopeLimits.of(camera).stretch())
        radius = self._reach[seen] * inverse_z * stretch
        radius += self._sigmas[seen] * np.float32(np.sqrt(LOW_PASS))
        inside = z > near_plane
        for row, focal, principal, size in (
            (0, camera.fx, camera.cx, camera.width),
            (1, camera.fy, camera.cy, camera.height),
        ):
            pixel = (rotation[row] @ means + translation[row]) * inverse_z
            pixel = pixel * np.float32(focal) + np.float32(principal)
            inside &= (pixel + radius > 0) & (pixel - radius < size)
        visible = np.flatnonzero(inside)
        indices = self._chunks.order[seen[visible]]
        nearest_first = depth_order(z[visible], indices)
        return indices[nearest_first[::-1]].astype(np.uint32)
