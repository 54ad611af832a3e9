# SPDX-License-Identifier: Apache-2.0
"""Photos that are exposed so long that their brightest parts are clipped.

A gain and a bias fitted over clipped pixels are far off, and leaving these pixels out is no
better: which ones are clipped depends on their noise. So the render is exposed like the photo,
clipping included, before the two are compared.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, UInt8Array
from gscpe.ranges import check_shares, check_whole

_BLOCK = 8
"""Pixels whose means are compared: the poses are not exact yet."""
_SOFT = 0.03
"""Differences beyond this count linearly."""
_STEPS = 15


@dataclass(frozen=True)
class ClippingSettings:
    """When a photo counts as clipped.

    Attributes:
        value: channels at least this bright, of 255, are clipped (JPEG moves 255 a little).
        min_share: a photo is, when more than this share of its pixels are.
    """

    value: int = 254
    min_share: float = 0.02

    def __post_init__(self) -> None:
        check_whole(self, "value", least=1, most=255)
        check_shares(self, "min_share")


def is_clipped(photo: UInt8Array, settings: ClippingSettings) -> bool:
    """Whether many of the pixels, (H, W, 3) uint8, are as bright as can be in a channel."""
    red, green, blue = np.moveaxis(photo[::2, ::2], 2, 0)
    brightest = np.maximum(np.maximum(red, green), blue)
    return bool(np.count_nonzero(brightest >= settings.value) > settings.min_share * brightest.size)


def fit_exposure(
    render: Float32Array, photo: UInt8Array, shown: BoolArray, settings: ClippingSettings
) -> tuple[float, float] | None:
    """Gain and bias of ``photo = min(gain * render + bias, 1)``; None when little is shown.

    Args:
        render: (H, W, 3), in [0, 1].
        photo: (H, W, 3) uint8, from about the same pose.
        shown: (H, W), where the render shows the map.
        settings: what counts as clipped.
    """
    height, width = (max(1, side // _BLOCK) for side in shown.shape)
    rendered, seen, clipped, whole = (
        cv2.resize(image.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        for image in (render, photo / np.float32(255.0), photo >= settings.value, shown)
    )
    # The mean of a block that is clipped in part follows neither line.
    usable = (whole[..., None] > 0.9) & ((clipped < 0.02) | (clipped > 0.98))
    if np.count_nonzero(usable) < 60:
        return None
    rendered, seen = (np.asarray(image[usable], np.float32) for image in (rendered, seen))

    fits = [_fit(rendered, seen, gain) for gain in (1.0, 2.0)]  # where all is clipped, no slope
    _, gain, bias = min(fits)
    return (gain, bias) if gain > 0 else None


def _fit(rendered: Float32Array, seen: Float32Array, gain: float) -> tuple[float, float, float]:
    """Cost, gain and bias by Gauss-Newton steps under the soft L1 loss."""
    bias = 0.0
    for _ in range(_STEPS):
        predicted = np.float32(gain) * rendered + np.float32(bias)
        misfit = seen - np.minimum(predicted, np.float32(1.0))
        weights = (predicted < 1.0) / np.sqrt(1.0 + (misfit / _SOFT) ** 2)
        design = np.stack([rendered, np.ones_like(rendered)])
        normal = (design * weights) @ design.T + 1e-6 * np.eye(2)
        step = np.linalg.solve(normal, (design * weights) @ misfit)
        gain, bias = gain + float(step[0]), bias + float(step[1])
        if np.abs(step).max() < 1e-4:
            break
    misfit = seen - np.minimum(np.float32(gain) * rendered + np.float32(bias), np.float32(1.0))
    return float(np.sum(np.sqrt(1.0 + (misfit / _SOFT) ** 2))), gain, bias


def expose(render: Float32Array, gain: float, bias: float) -> Float32Array:
    """The render, (H, W, 3), as a camera with this exposure takes it."""
    exposed = np.clip(np.float32(gain) * render + np.float32(bias), 0.0, 1.0)
    return np.asarray(exposed, dtype=np.float32)
