# SPDX-License-Identifier: Apache-2.0
"""Light that is unlike the map's from one part of a photo to the other: a lamp, a dark corner.

One gain and one bias cannot explain it, and what they leave pulls the pose. So the logarithm of
the gain is fitted to blocks of pixels as a polynomial of the place, and the render is lit by it
before it is compared; but only where that explains much more, because errors of the map have such
a shape too.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array
from gscpe.ranges import check_numbers, check_shares, check_whole

_BLOCK = 8
"""Pixels whose means are compared: the poses are not exact yet."""
_DARKEST = 0.02
"""Luminance below which a ratio says little."""
_SOFT = 0.1
"""Of the logarithm; larger differences count less."""
_STEPS = 8
_ENOUGH = 60
"""Blocks."""


@dataclass(frozen=True)
class IlluminationSettings:
    """When a photo is lit unevenly.

    Attributes:
        degree: of the polynomial.
        least_spread: standard deviation of the logarithm of the gain over the photo, below which
            one gain and one bias are enough.
        least_gain: share of what one gain leaves, below which the polynomial must bring the
            blocks' differences (median).
    """

    degree: int = 4
    least_spread: float = 0.15
    least_gain: float = 0.7

    def __post_init__(self) -> None:
        check_whole(self, "degree", least=1, most=6)
        check_numbers(self, "least_spread", least=0, infinite=True)
        check_shares(self, "least_gain")


def fit_illumination(
    render: Float32Array, photo: Float32Array, shown: BoolArray, settings: IlluminationSettings
) -> Float32Array | None:
    """The gain of each pixel, (H, W), where the photo is lit unevenly; None where it is not.

    Args:
        render, photo: (H, W) luminance in [0, 1], from about the same pose.
        shown: (H, W), where the render shows the map, and the photo is valid and not clipped.
        settings: see above.
    """
    height, width = shown.shape
    size = max(1, width // _BLOCK), max(1, height // _BLOCK)
    rendered, seen, whole = (
        cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for image in (render, photo, shown)
    )
    usable = (whole > 0.9) & (rendered > _DARKEST) & (seen > _DARKEST)
    if np.count_nonzero(usable) < _ENOUGH:
        return None
    ratio = np.log(seen[usable].astype(np.float64) / rendered[usable])
    y, x = ((np.arange(n) + 0.5) / n * 2.0 - 1.0 for n in (size[1], size[0]))
    columns, rows = np.meshgrid(x, y)
    design = _powers(columns, rows, settings.degree)
    coefficients = _fit(design[usable], ratio)
    gain = design @ coefficients
    left = np.median(np.abs(ratio - gain[usable]))
    without = np.median(np.abs(ratio - np.median(ratio)))
    if np.std(gain[usable]) < settings.least_spread or left > settings.least_gain * without:
        return None
    # Beyond the blocks that were seen, a polynomial may be anything.
    gain = np.exp(np.clip(gain, gain[usable].min(), gain[usable].max())).astype(np.float32)
    return np.asarray(cv2.resize(gain, (width, height), interpolation=cv2.INTER_LINEAR))


def _powers(x: Float64Array, y: Float64Array, degree: int) -> Float64Array:
    """(H, W, P): all products of powers of x and y up to a degree."""
    terms = [x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack(terms, axis=-1)


def _fit(design: Float64Array, values: Float64Array) -> Float64Array:
    """Robust least squares with Cauchy weights, (P,)."""
    weights = np.ones(len(values))
    coefficients: Float64Array = np.zeros(design.shape[1])
    for _ in range(_STEPS):
        weighted = design * weights[:, None]
        normal = weighted.T @ design + 1e-6 * len(values) * np.eye(design.shape[1])
        coefficients = np.asarray(np.linalg.solve(normal, weighted.T @ values))
        weights = 1.0 / (1.0 + ((values - design @ coefficients) / _SOFT) ** 2)
    return coefficients
