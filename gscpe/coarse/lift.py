# SPDX-License-Identifier: Apache-2.0
"""Lifts pixels of a render to 3D with its depth."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import BoolArray, Float64Array
from gscpe.geometry.projection import transform_points, unproject
from gscpe.geometry.se3 import inverse
from gscpe.render import RenderedView


def lift(
    view: RenderedView,
    pixels: Float64Array,
    min_opacity: float = 0.5,
    same_surface: float = 0.03,
) -> tuple[Float64Array, BoolArray]:
    """World points of pixels of a render.

    Depth is interpolated bilinearly among those of the four nearest pixels that lie on
    the surface of the nearest one, so that no point hangs between two surfaces.

    Args:
        view: the render.
        pixels: (N, 2), the centre of the top-left pixel at (0.5, 0.5).
        min_opacity: below it a pixel has no surface.
        same_surface: largest relative difference of depth within a surface.

    Returns:
        (N, 3) world points, and (N,) whether each could be lifted.
    """
    height, width = view.depth.shape
    column, row = pixels[:, 0] - 0.5, pixels[:, 1] - 0.5
    nearest_column = np.clip(np.rint(column).astype(np.intp), 0, width - 1)
    nearest_row = np.clip(np.rint(row).astype(np.intp), 0, height - 1)
    usable = (view.opacity >= min_opacity) & (view.depth > 0)
    nearest_depth = view.depth[nearest_row, nearest_column].astype(np.float64)
    liftable = usable[nearest_row, nearest_column]

    left, top = np.floor(column), np.floor(row)
    total = np.zeros(len(pixels))
    weighted_depth = np.zeros(len(pixels))
    for step_row in (0, 1):
        for step_column in (0, 1):
            c, r = left + step_column, top + step_row
            weight = (1.0 - np.abs(column - c)) * (1.0 - np.abs(row - r))
            ci = np.clip(c, 0, width - 1).astype(np.intp)
            ri = np.clip(r, 0, height - 1).astype(np.intp)
            depth = view.depth[ri, ci]
            same = np.abs(depth - nearest_depth) <= same_surface * nearest_depth
            weight = weight * (same & usable[ri, ci])
            total += weight
            weighted_depth += weight * depth
    depth = np.where(total > 0, weighted_depth / np.maximum(total, 1e-12), nearest_depth)
    points_in_cam = unproject(view.camera, pixels, depth)
    return transform_points(inverse(view.cam_from_world), points_in_cam), liftable
