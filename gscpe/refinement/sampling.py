# SPDX-License-Identifier: Apache-2.0
"""Interpolation and gradients of images, pixel centres at (0.5, 0.5)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array


@dataclass(frozen=True, eq=False)
class Corners:
    """The four pixels around each of N places, (N,) each; pixel (0, 0) where it is not inside.

    Attributes:
        upper_left, upper_right, lower_left, lower_right: their values.
        right, down: how far the place lies from the upper left pixel's centre, in [0, 1).
        inside: whether all four are in the image, and valid.
    """

    upper_left: Float32Array
    upper_right: Float32Array
    lower_left: Float32Array
    lower_right: Float32Array
    right: Float32Array
    down: Float32Array
    inside: BoolArray


def corners(image: Float32Array, valid: BoolArray, u: Float32Array, v: Float32Array) -> Corners:
    """What bilinear interpolation of an (H, W) image at pixels (u, v), (N,) each, is made of."""
    height, width = image.shape
    column, row = u - np.float32(0.5), v - np.float32(0.5)
    inside = (column >= 0) & (row >= 0) & (column < width - 1) & (row < height - 1)
    column = np.where(inside, column, np.float32(0.0))
    row = np.where(inside, row, np.float32(0.0))
    left, top = column.astype(np.int32), row.astype(np.int32)
    index = top * width + left
    flat = image.ravel()
    if not valid.all():
        allowed = valid.ravel()
        inside &= allowed[index] & allowed[index + 1]
        inside &= allowed[index + width] & allowed[index + width + 1]
    return Corners(
        flat[index],
        flat[index + 1],
        flat[index + width],
        flat[index + width + 1],
        column - left.astype(np.float32),  # exact: both are near each other
        row - top.astype(np.float32),
        inside,
    )


def sample_bilinear(
    image: Float32Array, valid: BoolArray, u: Float32Array, v: Float32Array
) -> tuple[Float32Array, BoolArray]:
    """Values of an (H, W) image at pixels (u, v), (N,) each, and whether all four
    contributing pixels are valid. cv2.remap rounds to 1/32 px; this is exact."""
    at = corners(image, valid, u, v)
    a, b = at.right, at.down
    upper = at.upper_left + (at.upper_right - at.upper_left) * a
    lower = at.lower_left + (at.lower_right - at.lower_left) * a
    return np.asarray(upper + (lower - upper) * b, dtype=np.float32), at.inside


def gradient(image: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Derivatives by u and v, a pixel, with Scharr's kernel (3x3, 1/32 [3 10 3])."""
    by_u = cv2.Scharr(image, cv2.CV_32F, 1, 0, scale=1.0 / 32.0)
    by_v = cv2.Scharr(image, cv2.CV_32F, 0, 1, scale=1.0 / 32.0)
    return np.asarray(by_u, dtype=np.float32), np.asarray(by_v, dtype=np.float32)
