# SPDX-License-Identifier: Apache-2.0
"""What a renderer returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gscpe.arrays import Float32Array, Float64Array
from gscpe.geometry.camera import Camera
from gscpe.scene.map_frame import TYPICAL_DEPTH

_CLOSE = 0.5
"""Metres from which surfaces are seen, below which lengths made for rooms are too large."""


@dataclass(frozen=True, eq=False)
class RenderedView:
    """A splat seen by a pinhole camera; everything float32, row 0 on top.

    Attributes:
        rgb: (H, W, 3) composited over black; about [0, 1], more where the splat says so.
        opacity: (H, W) in [0, 1], the sum of the compositing weights.
        depth: (H, W) expected z-depth in world units, 0 where nothing was seen.
        depth_variance: (H, W) variance of z-depth under the compositing weights.
        camera: the camera of the view.
        cam_from_world: (4, 4) float64, the pose of the view.
    """

    rgb: Float32Array
    opacity: Float32Array
    depth: Float32Array
    depth_variance: Float32Array
    camera: Camera
    cam_from_world: Float64Array

    def __repr__(self) -> str:
        seen = self.depth[self.depth > 0]
        depth = f"{np.median(seen):.4g}" if len(seen) else "none"
        return (
            f"RenderedView({self.camera.width}x{self.camera.height}, "
            f"opacity {self.opacity.mean():.2f} (mean), depth {depth} (median))"
        )

    def tolerance_unit(self, metres_per_unit: float = 1.0) -> float:
        """Metres per unit for tolerances, which are made for rooms: of the unit where the median
        depth is between half a metre and 2 m; smaller where it is more, larger where it is less."""
        seen = self.depth > 0
        if not np.any(seen):
            return metres_per_unit
        depth = metres_per_unit * float(np.median(self.depth[seen]))
        return metres_per_unit * min(1.0, TYPICAL_DEPTH / depth) * max(1.0, _CLOSE / depth)


class Renders(Protocol):
    """Anything that renders a map from any pose: a :class:`gscpe.Renderer`, a
    :class:`gscpe.Localizer`, or a wrapper around one."""

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        """The map as a pinhole camera with this (4, 4) pose sees it."""
        ...
