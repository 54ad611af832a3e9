# SPDX-License-Identifier: Apache-2.0
"""The constants and bounds of 3DGS's splatting that every rasterizer keeps to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float32Array
from gscpe.geometry.camera import Camera

MIN_ALPHA = 1.0 / 255.0
"""Contributions below this are skipped."""

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


def sigmas_in_sight(opacities: Float32Array) -> Float32Array:
    """Radius, in standard deviations, inside which alpha is at least 1/255, (N,) float32;
    0 for Gaussians that are fainter everywhere."""
    peak = np.maximum(255.0 * opacities, 1.0)
    return np.asarray(np.sqrt(2.0 * np.log(peak)), dtype=np.float32)
