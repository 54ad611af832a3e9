"""Interpolation and gradients of images, pixel centres at (0.5, 0.5)."""

from __future__ import annotations

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array


def sample_bilinear(
    image: Float32Array, valid: BoolArray, u: Float32Array, v: Float32Array
) -> tuple[Float32Array, BoolArray]:
    """Values of an (H, W) image at pixels (u, v), (N,) each, and whether all four
    contributing pixels are valid. cv2.remap rounds to 1/32 px; this is exact."""
    height, width = image.shape
    column, row = u - np.float32(0.5), v - np.float32(0.5)
    inside = (column >= 0) & (row >= 0) & (column < width - 1) & (row < height - 1)
    column = np.where(inside, column, np.float32(0.0))
    row = np.where(inside, row, np.float32(0.0))
    left, top = column.astype(np.int32), row.astype(np.int32)
    a, b = column - left, row - top
    index = top * width + left
    flat = image.ravel()
    upper = flat[index] * (1 - a) + flat[index + 1] * a
    lower = flat[index + width] * (1 - a) + flat[index + width + 1] * a
    values = upper * (1 - b) + lower * b
    if not valid.all():
        allowed = valid.ravel()
        inside &= allowed[index] & allowed[index + 1]
        inside &= allowed[index + width] & allowed[index + width + 1]
    return np.asarray(values, dtype=np.float32), inside


def gradient(image: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Derivatives by u and v, a pixel, with Scharr's kernel (3x3, 1/32 [3 10 3])."""
    by_u = cv2.Scharr(image, cv2.CV_32F, 1, 0, scale=1.0 / 32.0)
    by_v = cv2.Scharr(image, cv2.CV_32F, 0, 1, scale=1.0 / 32.0)
    return np.asarray(by_u, dtype=np.float32), np.asarray(by_v, dtype=np.float32)
