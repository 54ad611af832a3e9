# SPDX-License-Identifier: Apache-2.0
"""Gaussians in chunks that lie close together, so that a view skips what it cannot see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array, Float64Array, IntArray
from gscpe.geometry.camera import Camera
from gscpe.render.splatting import LOW_PASS, MIN_ALPHA, SlopeLimits, sigmas_in_sight
from gscpe.splats.gaussians import GaussianScene

_CHUNK = 256
_MOST_BLUR = np.sqrt(2.0 * np.log(255.0) * LOW_PASS)  # pixels that the low-pass can add


@dataclass(frozen=True, eq=False)
class SpatialChunks:
    """The Gaussians that can be seen at all, along a Morton curve, cut into chunks.

    Attributes:
        order: (M,) indices into the scene, along the curve; those fainter than 1/255 left out.
        begins: (C + 1,) chunk i is order[begins[i]:begins[i + 1]].
        centres, half_extents: (C, 3) bounding boxes of the chunks' means, in the world.
        reaches: (C,) the farthest that alpha stays above 1/255.
        near: distance below which centres are too near to be drawn.
    """

    order: IntArray
    begins: IntArray
    centres: Float64Array
    half_extents: Float64Array
    reaches: Float32Array
    near: float

    @classmethod
    def of(cls, scene: GaussianScene) -> SpatialChunks:
        order = np.flatnonzero(scene.opacities >= MIN_ALPHA)
        if len(order):
            order = order[morton_order(scene.means[order])]
        begins = np.append(np.arange(0, len(order), _CHUNK), len(order))
        if not len(order):
            nothing = np.zeros((0, 3))
            return cls(order, begins, nothing, nothing, np.zeros(0, dtype=np.float32), scene.near)
        starts, means = begins[:-1], scene.means[order].astype(np.float64)
        low, high = np.minimum.reduceat(means, starts), np.maximum.reduceat(means, starts)
        reaches = sigmas_in_sight(scene.opacities[order]) * scene.scales[order].max(axis=1)
        return cls(
            order=order,
            begins=begins,
            centres=0.5 * (low + high),
            half_extents=0.5 * (high - low),
            reaches=np.maximum.reduceat(reaches, starts),
            near=scene.near,
        )

    def positions_in_view(self, camera: Camera, cam_from_world: Float64Array) -> IntArray:
        """Positions in ``order``, ascending, among them every Gaussian that touches the image."""
        seen = np.concatenate([[False], self._may_touch(camera, cam_from_world), [False]])
        edges = self.begins[np.flatnonzero(seen[1:] != seen[:-1])]
        runs = [np.arange(*run) for run in zip(edges[::2], edges[1::2], strict=True)]
        return np.concatenate(runs) if runs else np.zeros(0, dtype=np.int64)

    def _may_touch(self, camera: Camera, cam_from_world: Float64Array) -> NDArray[np.bool_]:
        """False for chunks all of whose Gaussians are too near or beyond one image border.

        A Gaussian at x, z reaches ``reach * focal / z + blur`` pixels at most; so it lies
        beyond the right border where ``f x + (c - width - blur) z > reach * focal``.
        """
        x_axis, y_axis, z_axis = cam_from_world[:3]  # rows: rotation and translation
        reaches = self.reaches * max(camera.fx, camera.fy) * SlopeLimits.of(camera).stretch()
        seen = self._least(-z_axis) < -self.near
        for axis, focal, principal, size in (
            (x_axis, camera.fx, camera.cx, camera.width),
            (y_axis, camera.fy, camera.cy, camera.height),
        ):
            for plane in (
                focal * axis + (principal - size - _MOST_BLUR) * z_axis,
                -focal * axis - (principal + _MOST_BLUR) * z_axis,
            ):
                seen &= self._least(plane) <= reaches
        return seen

    def _least(self, plane: Float64Array) -> Float64Array:
        """The least of ``plane[:3] @ x + plane[3]`` over each chunk's box, (C,)."""
        least = self.centres @ plane[:3] - self.half_extents @ np.abs(plane[:3]) + plane[3]
        return np.asarray(least, dtype=np.float64)


def morton_order(points: NDArray[np.floating]) -> IntArray:
    """Positions of points, (N,), along a Morton (Z-order) curve; equal ones as they come.

    The curve's grid spans the points but the outermost half per cent on each side: a few far
    floaters must not put all others into one cell.
    """
    points = points.astype(np.float64)  # a difference may overflow float32
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    cells = (points - low) / np.maximum(high - low, np.finfo(np.float32).tiny)
    codes = np.zeros(len(points), dtype=np.uint64)
    for axis in range(3):
        cell = np.clip(cells[:, axis] * 1023.0, 0.0, 1023.0).astype(np.uint64)
        for bit in range(10):
            shift = np.uint64(2 * bit + axis)
            codes |= (cell & np.uint64(1 << bit)) << shift
    return np.argsort(codes, kind="stable")
