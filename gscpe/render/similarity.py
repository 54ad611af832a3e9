# SPDX-License-Identifier: Apache-2.0
"""How alike two images of a scene look, whatever the illumination."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import BoolArray, Float32Array
from gscpe.photos.local_window import at_full_size, local_mean

_MIN_STANDARD_DEVIATION = 0.01
_MIN_PIXELS = 100


def local_correlation(
    first: Float32Array, second: Float32Array, valid: BoolArray, window_sigma: float = 8.0
) -> float:
    """Mean local correlation of two luminance images, (H, W), in [-1, 1].

    Both are normalized to local mean 0 and deviation 1 (Gaussian window, pixels) before they
    are compared, so that gain, bias, vignetting and slow shadows do not count. Places where
    both are flat have nothing to compare and are left out.

    Returns:
        The correlation over valid pixels; NaN where too few have anything to compare.
    """
    weight = valid.astype(np.float32)
    total = np.maximum(local_mean(weight, window_sigma), np.float32(1e-3))
    a, a_deviation = _normalize(first, weight, total, window_sigma)
    b, b_deviation = _normalize(second, weight, total, window_sigma)
    # Textured where either image says so: a flat render of a textured place disagrees.
    textured = valid & (np.maximum(a_deviation, b_deviation) > 2.0 * _MIN_STANDARD_DEVIATION)
    if np.count_nonzero(textured) < _MIN_PIXELS:
        return float("nan")
    a, b = a[textured], b[textured]
    # Among the places that are left, the deviations need not be 1 on average: in pale scenes they
    # are more, and the correlation would exceed 1.
    size = float(np.sqrt(np.mean(a * a) * np.mean(b * b)))
    return float(np.mean(a * b)) / max(1.0, size)


def _normalize(
    image: Float32Array, weight: Float32Array, total: Float32Array, sigma: float
) -> tuple[Float32Array, Float32Array]:
    """The image with local mean 0 and deviation 1 over valid pixels; and the deviation.

    ``total`` is the local mean of the weight of each pixel.
    """
    mean = at_full_size(local_mean(image * weight, sigma) / total, image)
    centred = (image - mean) * weight
    deviation = at_full_size(np.sqrt(local_mean(centred * centred, sigma) / total), image)
    normalized = centred / np.maximum(deviation, _MIN_STANDARD_DEVIATION)
    return np.asarray(normalized, dtype=np.float32), deviation
