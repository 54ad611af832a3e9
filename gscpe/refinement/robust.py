# SPDX-License-Identifier: Apache-2.0
"""Tukey's biweight (Beaton and Tukey, Technometrics 1974) and a robust scale."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import Float32Array

TUKEY_CUTOFF = 4.685
"""In standard deviations: 95% efficient where the noise is Gaussian."""
_MAD_TO_SIGMA = 1.4826


def robust_sigma(residuals: Float32Array) -> float:
    """Median absolute deviation from zero, as a standard deviation."""
    step = max(1, len(residuals) // 20_000)
    sizes = np.abs(residuals[::step])
    middle = len(sizes) // 2
    ordered = np.partition(sizes, middle)  # np.median takes three times as long
    median = ordered[middle]
    if len(sizes) % 2 == 0:
        median = 0.5 * (ordered[:middle].max() + median)
    return float(_MAD_TO_SIGMA * median)


def tukey_weights(residuals: Float32Array, sigma: float) -> Float32Array:
    """psi(r) / r, in [0, 1]."""
    kept = _kept(residuals, sigma)
    return np.asarray(kept * kept, dtype=np.float32)


def tukey_curvature(residuals: Float32Array, sigma: float) -> Float32Array:
    """d psi / d r: how much of a residual's weight a step can count on; negative on the
    kernel's shoulders."""
    kept = _kept(residuals, sigma)
    return np.asarray(kept * (np.float32(5.0) * kept - np.float32(4.0)), dtype=np.float32)


def _kept(residuals: Float32Array, sigma: float) -> Float32Array:
    scaled = residuals * np.float32(1.0 / (TUKEY_CUTOFF * sigma))
    return np.asarray(np.maximum(np.float32(1.0) - scaled * scaled, np.float32(0.0)))
