# SPDX-License-Identifier: Apache-2.0
"""The demonstration's overview, which says in the picture how it is to be read."""

from __future__ import annotations

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float64Array, UInt8Array
from gscpe.geometry import se3
from gscpe.geometry.projection import pixel_centres, project, transform_points, unproject
from gscpe.render import RenderedView

ARROW_SCALE = 100
"""How many times as long as the shift itself it is drawn."""

_SPACING = 26
_MIN_OPACITY = 0.9
ARROW = (255, 210, 60)
_SHIFT = 4
"""Binary digits behind the point in OpenCV's drawing coordinates."""


def shifts(
    view: RenderedView, cam_from_world: Float64Array
) -> tuple[Float64Array, Float64Array, BoolArray]:
    """How far off a pose puts what a view from the true pose shows.

    Args:
        view: from the true pose.
        cam_from_world: (4, 4), the pose that is judged.

    Returns:
        Pixels, (H, W, 2), COLMAP's; where the pose moves their points to, (H, W, 2) pixels,
        relative to them; and where this is known, (H, W): where the map shows a surface.
    """
    known = (view.opacity >= _MIN_OPACITY) & (view.depth > 0)
    pixels = pixel_centres(view.camera).reshape(-1, 2)
    depth = np.where(known, view.depth, 1.0).astype(np.float64).ravel()
    points = unproject(view.camera, pixels, depth)
    there = transform_points(cam_from_world @ se3.inverse(view.cam_from_world), points)
    shape = (*known.shape, 2)
    moved = project(view.camera, there) - pixels
    return pixels.reshape(shape), moved.reshape(shape), known


def shift_picture(
    photo: UInt8Array, view: RenderedView, cam_from_world: Float64Array
) -> UInt8Array:
    """The photo, darkened, with arrows from where points belong to where the pose puts them,
    ARROW_SCALE times as long; (H, W, 3) uint8. Arguments as of :func:`shifts`."""
    pixels, moved, known = shifts(view, cam_from_world)
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)
    picture = np.repeat((0.4 * grey)[:, :, None], 3, axis=2).astype(np.uint8)
    half = _SPACING // 2
    rows, columns = np.nonzero(known[half::_SPACING, half::_SPACING])
    for row, column in zip(half + _SPACING * rows, half + _SPACING * columns, strict=True):
        begin = pixels[row, column]
        end = begin + ARROW_SCALE * moved[row, column]
        cv2.circle(picture, _opencv_point(begin), 2 << _SHIFT, ARROW, -1, cv2.LINE_AA, _SHIFT)
        cv2.line(picture, _opencv_point(begin), _opencv_point(end), ARROW, 2, cv2.LINE_AA, _SHIFT)
    return picture


def _opencv_point(pixel: Float64Array) -> tuple[int, int]:
    """OpenCV draws the centre of the top-left pixel at (0, 0)."""
    column, row = np.rint((pixel - 0.5) * (1 << _SHIFT)).astype(int)
    return int(column), int(row)
