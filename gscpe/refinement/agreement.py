"""How well a render, brought to the photo, looks like it, whatever the illumination."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import BoolArray, Float32Array, Float64Array
from gscpe.refinement.lucas_kanade import warp
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.sampling import sample_bilinear

_MIN_STANDARD_DEVIATION = 0.01


def photometric_agreement(
    anchor: AnchorLevel,
    photo: ImageLevel,
    photo_from_anchor: Float64Array,
    window_sigma: float = 8.0,
) -> tuple[float, float]:
    """Mean local correlation of an anchor and the photo warped to it, and the overlap.

    Both are normalized to local mean 0 and deviation 1 (Gaussian window) before they are
    compared, so that gain, bias, vignetting and slow shadows do not count. Flat places have
    nothing to compare and are left out by their low deviation.

    Returns:
        The correlation, in [-1, 1], NaN where nothing overlaps; and the share of the
        anchor's pixels, in [0, 1], that are visible in the photo.
    """
    camera = anchor.camera
    row, column = np.divmod(np.arange(anchor.image.size), camera.width)
    z = anchor.depth.ravel()
    x = (column.astype(np.float32) + np.float32(0.5 - camera.cx)) / np.float32(camera.fx) * z
    y = (row.astype(np.float32) + np.float32(0.5 - camera.cy)) / np.float32(camera.fy) * z
    u, v, ahead = warp(np.stack([x, y, z]).astype(np.float32), photo_from_anchor, photo.camera)
    values, inside = sample_bilinear(photo.image, photo.valid, u, v)
    common = (inside & ahead).reshape(anchor.image.shape) & anchor.valid
    overlap = float(np.count_nonzero(common)) / common.size
    if overlap == 0.0:
        return float("nan"), 0.0
    a, a_deviation = _normalize(anchor.image, common, window_sigma)
    b, b_deviation = _normalize(values.reshape(anchor.image.shape), common, window_sigma)
    # Textured where either image says so: a flat render of a textured place disagrees.
    textured = common & (np.maximum(a_deviation, b_deviation) > 2.0 * _MIN_STANDARD_DEVIATION)
    if np.count_nonzero(textured) < 100:
        return float("nan"), overlap
    return float(np.mean(a[textured] * b[textured])), overlap


def _normalize(
    image: Float32Array, valid: BoolArray, sigma: float
) -> tuple[Float32Array, Float32Array]:
    """The image with local mean 0 and deviation 1 over valid pixels; and the deviation."""
    weight = valid.astype(np.float32)
    total = np.maximum(_window(weight, sigma), 1e-3)
    mean = _window(image * weight, sigma) / total
    centred = (image - mean) * weight
    deviation = np.sqrt(_window(centred * centred, sigma) / total)
    normalized = centred / np.maximum(deviation, _MIN_STANDARD_DEVIATION)
    return normalized.astype(np.float32), deviation.astype(np.float32)


def _window(image: NDArray[np.floating], sigma: float) -> Float32Array:
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma)
    return np.asarray(blurred, dtype=np.float32)
