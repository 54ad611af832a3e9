"""What a renderer returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gscpe.arrays import Float32Array, Float64Array
from gscpe.geometry.camera import Camera

_TYPICAL_DEPTH = 2.0


@dataclass(frozen=True, eq=False)
class RenderedView:
    """A splat seen by a pinhole camera; everything float32, row 0 on top.

    Attributes:
        rgb: (H, W, 3) composited over black; about [0, 1], more where the splat says so.
        opacity: (H, W) in [0, 1], the sum of the compositing weights.
        depth: (H, W) expected z-depth in map units, 0 where nothing was seen.
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

    def metres_per_unit(self, known: float | None) -> float:
        """The map's unit where it is known; else such that the median depth becomes 2 m, the
        depth that tolerances in metres were made for; 1 where nothing is seen."""
        if known is not None:
            return known
        return self._unit_of_the_depth()

    def tolerance_unit(self, known: float | None) -> float:
        """Metres per unit for tolerances in metres, which are made for rooms: as
        :meth:`metres_per_unit`, or smaller where the median depth is more than 2 m."""
        return min(self.metres_per_unit(known), self._unit_of_the_depth())

    def _unit_of_the_depth(self) -> float:
        seen = self.depth > 0
        return _TYPICAL_DEPTH / float(np.median(self.depth[seen])) if np.any(seen) else 1.0


class Renders(Protocol):
    """What shows a map from any pose: a :class:`gscpe.Renderer`, a :class:`gscpe.Localizer`, or
    something that stands between."""

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        """The map as a pinhole camera with this (4, 4) pose sees it."""
        ...
