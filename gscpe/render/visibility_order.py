"""Which Gaussians a camera may see, and in what order. Pure NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array, Float64Array, IntArray
from gscpe.geometry.camera import Camera
from gscpe.scene.gaussians import GaussianScene

NEAR = 0.2
"""Gaussians with a centre nearer than this (map units) are not drawn, as in 3DGS."""

MIN_ALPHA = 1.0 / 255.0
LOW_PASS = 0.3
"""Variance (pixels squared) that 3DGS adds to every projected Gaussian."""


@dataclass(frozen=True)
class SlopeLimits:
    """Bounds of x/z and y/z where the projection is linearized, as in 3DGS: 30% of half the
    field of view beyond the image, so that Gaussians beside it do not blow up."""

    low_x: float
    low_y: float
    high_x: float
    high_y: float

    @classmethod
    def of(cls, camera: Camera) -> SlopeLimits:
        margin_x = 0.15 * camera.width / camera.fx
        margin_y = 0.15 * camera.height / camera.fy
        return cls(
            low_x=-camera.cx / camera.fx - margin_x,
            low_y=-camera.cy / camera.fy - margin_y,
            high_x=(camera.width - camera.cx) / camera.fx + margin_x,
            high_y=(camera.height - camera.cy) / camera.fy + margin_y,
        )

    def as_array(self) -> Float32Array:
        """(4,) low x, low y, high x, high y."""
        return np.array([self.low_x, self.low_y, self.high_x, self.high_y], dtype=np.float32)

    def stretch(self) -> float:
        """Bound of the projection's derivative: |J| <= focal / z * stretch."""
        slope_x, slope_y = max(-self.low_x, self.high_x), max(-self.low_y, self.high_y)
        return float(np.sqrt(1.0 + slope_x**2 + slope_y**2))


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
        self._means = np.ascontiguousarray(scene.means.T)
        # The radius, in sigmas, inside which alpha is at least 1/255.
        visible = scene.opacities >= MIN_ALPHA
        sigmas = np.sqrt(2.0 * np.log(np.where(visible, 255.0 * scene.opacities, 1.0)))
        self._sigmas: Float32Array = sigmas.astype(np.float32)
        self._reach: Float32Array = self._sigmas * scene.scales.max(axis=1)
        self._never: NDArray[np.bool_] = ~visible

    def back_to_front(self, camera: Camera, cam_from_world: Float64Array) -> NDArray[np.uint32]:
        """Indices of the Gaussians that may touch the image, farthest first, (M,) uint32."""
        rotation = cam_from_world[:3, :3].astype(np.float32)
        translation = cam_from_world[:3, 3].astype(np.float32)
        z = view_depths(self._means, cam_from_world)
        candidates = np.flatnonzero((z > NEAR) & ~self._never)
        means, z = self._means[:, candidates], z[candidates]
        inverse_z = 1.0 / z
        stretch = np.float32(max(camera.fx, camera.fy) * SlopeLimits.of(camera).stretch())
        radius = self._reach[candidates] * inverse_z * stretch
        radius += self._sigmas[candidates] * np.float32(np.sqrt(LOW_PASS))
        inside = np.ones(len(candidates), dtype=bool)
        for row, focal, principal, size in (
            (0, camera.fx, camera.cx, camera.width),
            (1, camera.fy, camera.cy, camera.height),
        ):
            pixel = (rotation[row] @ means + translation[row]) * inverse_z
            pixel = pixel * np.float32(focal) + np.float32(principal)
            inside &= (pixel + radius > 0) & (pixel - radius < size)
        visible = np.flatnonzero(inside)
        nearest_first = depth_order(z[visible], candidates[visible])
        return candidates[visible[nearest_first[::-1]]].astype(np.uint32)
