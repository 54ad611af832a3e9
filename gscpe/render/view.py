"""What a renderer returns."""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.arrays import Float32Array, Float64Array
from gscpe.geometry.camera import Camera


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
