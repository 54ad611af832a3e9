# SPDX-License-Identifier: Apache-2.0
"""Depth regularization: where a photo sees a triangulated point, the render is to be as deep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array, IntArray
from gscpe.geometry.camera import Camera
from gscpe.geometry.projection import project, transform_points
from gscpe.render.view import RenderedView
from gscpe.training.rasterizer import DepthGradient

_SURE = 0.02
"""Relative error below which the penalty is quadratic: what a pixel's mixture of surfaces, and
triangulation, are off by anyway."""

_LEAST_OPACITY = 0.5
"""A render that shows less has no surface there whose depth could be right or wrong."""


@dataclass(frozen=True, eq=False)
class PointDepths:
    """Points that a photo sees.

    Attributes:
        rows, columns: (M,) the pixels that they are in.
        depths: (M,) float32, z in the camera, world units, positive.
    """

    rows: IntArray
    columns: IntArray
    depths: Float32Array

    def __len__(self) -> int:
        return len(self.depths)

    @classmethod
    def of(
        cls,
        positions: Float64Array,
        camera: Camera,
        cam_from_world: Float64Array,
        valid: BoolArray | None = None,
    ) -> PointDepths:
        """Those of the points that lie in a photo.

        Args:
            positions: (N, 3), in the world; of points that nothing hides from the camera.
            camera: pinhole.
            cam_from_world: (4, 4), its pose.
            valid: (H, W), the photo's pixels that count; None for all.
        """
        in_cam = transform_points(cam_from_world, positions)
        in_cam = in_cam[in_cam[:, 2] > 0]
        pixels = np.floor(project(camera, in_cam))
        inside = np.all((pixels >= 0) & (pixels < (camera.width, camera.height)), axis=1)
        columns, rows = pixels[inside].astype(np.intp).T
        depths = in_cam[inside, 2].astype(np.float32)
        if valid is not None:
            counts = valid[rows, columns]
            rows, columns, depths = rows[counts], columns[counts], depths[counts]
        return cls(rows, columns, depths)


def depth_loss(
    view: RenderedView, points: PointDepths, weight: float
) -> tuple[float, DepthGradient]:
    """A penalty on depths that differ from those of the points, and its gradient.

    Each point counts like ``weight`` pixels of the photo: the loss is weight / (H W) times the sum
    of Huber's penalty of log(rendered depth / depth of the point). The logarithm makes near and far
    count alike; that the penalty does not grow faster than the error is for wrong points.
    """
    shown = view.opacity[points.rows, points.columns] >= _LEAST_OPACITY
    rows, columns = points.rows[shown], points.columns[shown]
    rendered = view.depth[rows, columns]
    error = np.log(rendered / points.depths[shown])
    scale = weight / view.opacity.size
    size = np.abs(error)
    penalty = np.where(size < _SURE, 0.5 * error**2 / _SURE, size - 0.5 * _SURE)
    slope = np.clip(error / _SURE, -1.0, 1.0)
    values = np.asarray(scale * slope / rendered, dtype=np.float32)
    return scale * float(penalty.sum()), DepthGradient(rows, columns, values)
