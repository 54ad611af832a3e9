# SPDX-License-Identifier: Apache-2.0
"""Moves matches to sub-pixel by Lucas-Kanade on locally normalized images."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.errors import SettingsError
from gscpe.photos.local_window import at_full_size, local_mean


@dataclass(frozen=True)
class PolishSettings:
    """How matches are moved.

    Attributes:
        window: side of the square that is compared, pixels, odd.
        max_shift: a match that would move farther, in pixels, stays where it was.
        sigma: of the local mean and contrast, pixels.
    """

    window: int = 15
    max_shift: float = 3.0
    sigma: float = 8.0

    def __post_init__(self) -> None:
        if self.window < 3 or self.window % 2 == 0 or self.max_shift <= 0 or self.sigma <= 0:
            raise SettingsError("polishing needs an odd window of at least 3 pixels, and positive")


def normalize_locally(rgb: UInt8Array, sigma: float = 8.0) -> UInt8Array:
    """Luminance, (H, W) uint8, less its local mean and divided by its local deviation: photo
    and render differ in exposure and contrast, which pulls an unnormalized match aside."""
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32)
    difference = grey - at_full_size(local_mean(grey, sigma), grey)
    deviation = np.sqrt(local_mean(difference * difference, sigma))
    normalized = 128.0 + difference * at_full_size(
        np.float32(40.0) / (deviation + np.float32(2.0)), grey
    )
    return np.asarray(np.clip(normalized, 0.0, 255.0), dtype=np.uint8)


def for_polishing(rgb: UInt8Array, settings: PolishSettings | None) -> UInt8Array | None:
    """What :func:`polish` needs of an (H, W, 3) uint8 RGB image; None: nothing is polished."""
    return None if settings is None else normalize_locally(rgb, settings.sigma)


def polish(
    fixed: UInt8Array | None,
    moving: UInt8Array | None,
    fixed_pixels: Float64Array,
    moving_pixels: Float64Array,
    settings: PolishSettings | None,
) -> Float64Array:
    """Better places in ``moving`` for what is at ``fixed_pixels`` in ``fixed``.

    Args:
        fixed, moving: (H, W) uint8 each, from :func:`for_polishing`.
        fixed_pixels, moving_pixels: (N, 2), the centre of the top-left pixel at (0.5, 0.5).

    Returns:
        (N, 2) pixels in ``moving``; unchanged where the alignment failed, and all of them
        where the settings are None.
    """
    if settings is None or fixed is None or moving is None or len(fixed_pixels) == 0:
        return moving_pixels
    fixed, moving = _of_one_size(fixed, moving)
    start = (moving_pixels - 0.5).astype(np.float32)[:, None]
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        fixed,
        moving,
        (fixed_pixels - 0.5).astype(np.float32)[:, None],
        start.copy(),
        winSize=(settings.window, settings.window),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    shift = np.linalg.norm(moved - start, axis=2)[:, 0]
    good = (found[:, 0] == 1) & (shift <= settings.max_shift)
    return np.where(good[:, None], moved[:, 0].astype(np.float64) + 0.5, moving_pixels)


def _of_one_size(a: UInt8Array, b: UInt8Array) -> tuple[UInt8Array, UInt8Array]:
    """OpenCV insists on it; the right and lower borders are continued."""
    height, width = np.maximum(a.shape, b.shape)
    a, b = (
        np.pad(each, ((0, height - each.shape[0]), (0, width - each.shape[1])), mode="edge")
        if each.shape != (height, width)
        else each
        for each in (a, b)
    )
    return a, b
