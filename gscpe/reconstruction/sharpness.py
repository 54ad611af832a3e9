# SPDX-License-Identifier: Apache-2.0
"""How sharp a picture is, whatever its contrast, noise and size."""

from __future__ import annotations

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, UInt8Array

_COMPARED = 640
_FINE, _COARSE = 1.0, 3.0  # pixels
_EDGES = 50  # percentile of the gradients along edges
_FLAT = 0.3  # grey levels a pixel: noise and rounding


def sharpness(rgb: UInt8Array) -> float:
    """How much steeper the strongest edges are when looked at closely: of a picture that is blurred
    by s pixels (standard deviation, at 640 pixels), 0.3 for s = 2, 0.1 for 4, and 0 without edges.
    Sharp photos have 0.45 to 0.75.

    The gradient of a step after smoothing by t is as 1 / sqrt(s² + t² + 1/2), where the half is
    that of the differences; so that for t = 1 is r = sqrt((s² + 9.5) / (s² + 1.5)) times that for
    t = 3, along the latter, and what is returned is (r - 1) / 2. Noise takes no part.

    Args:
        rgb: (H, W, 3) uint8, or grey, (H, W).
    """
    grey = rgb if rgb.ndim == 2 else np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)
    scale = _COMPARED / max(grey.shape)
    if scale < 1.0:
        smaller = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        grey = np.asarray(smaller, np.uint8)
    fine, coarse = (_gradient(grey, sigma) for sigma in (_FINE, _COARSE))
    length = np.linalg.norm(coarse, axis=0)
    edges = _crests(coarse, length) & (length >= _FLAT)
    if not np.any(edges):
        return 0.0
    edges &= length >= np.percentile(length[edges], _EDGES)
    ratio = float(np.sum(fine[:, edges] * coarse[:, edges]) / np.sum(coarse[:, edges] ** 2))
    return max(ratio - 1.0, 0.0) / (_COARSE / _FINE - 1.0)


def _crests(gradient: Float32Array, length: Float32Array) -> BoolArray:
    """Where the gradient is the steepest across its edge."""
    across, down = np.abs(gradient)
    inner = np.pad(length, 1)
    left_right = np.maximum(inner[1:-1, :-2], inner[1:-1, 2:])
    above_below = np.maximum(inner[:-2, 1:-1], inner[2:, 1:-1])
    return np.asarray(length >= np.where(across > down, left_right, above_below))


def _gradient(grey: UInt8Array, sigma: float) -> Float32Array:
    """(2, H, W), after smoothing."""
    smooth = cv2.GaussianBlur(np.asarray(grey, dtype=np.float32), (0, 0), sigma)
    along = [cv2.Sobel(smooth, cv2.CV_32F, dx, 1 - dx, scale=1 / 8) for dx in (1, 0)]
    return np.stack(along).astype(np.float32)
