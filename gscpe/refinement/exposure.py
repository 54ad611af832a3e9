# SPDX-License-Identifier: Apache-2.0
"""Photos that are exposed so long that their brightest parts are clipped.

A gain and a bias fitted over clipped pixels are far off, and leaving these pixels out is no
better: which ones are clipped depends on their noise. So the render is exposed like the photo,
clipping included, before the two are compared. Where much is clipped, they are compared by the
darker channels, because seldom all three are clipped.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, UInt8Array
from gscpe.photos.photo import brightest_channel
from gscpe.ranges import check_numbers, check_shares, check_whole
from gscpe.refinement.pyramid import AnchorLevel

_BLOCK = 8
"""Pixels whose means are compared: the poses are not exact yet."""
_SOFT = 0.03
"""Differences beyond this count linearly."""
_STEPS = 15
"""Of Gauss-Newton, at most."""
_ENOUGH = 60
"""Blocks, of a channel each."""
_CHOICES = 2
"""Times that blocks are chosen again by the fit before."""
_SURELY_DARKER = 0.85
"""Than white: what is expected to be so is hardly clipped."""
_WHITE = 1.0 - 1e-4
_DARKER = 4.0
"""How much more the darker of two channels counts: by this, to the power of their difference."""


@dataclass(frozen=True)
class ClippingSettings:
    """When a photo counts as clipped.

    Attributes:
        value: channels at least this bright, of 255, are clipped (JPEG moves 255 a little).
        min_share: a photo is, when more than this share of its pixels are.
        min_share_matched: share from which renders are exposed like the photo also before they are
            matched with it, and aligned by what their darker channels show.

    Raises:
        SettingsError: a value is out of its range.
    """

    value: int = 254
    min_share: float = 0.02
    min_share_matched: float = 0.2

    def __post_init__(self) -> None:
        check_whole(self, "value", least=1, most=255)
        check_shares(self, "min_share")
        check_numbers(self, "min_share_matched", least=self.min_share, most=1)


def clipped_share(photo: UInt8Array, settings: ClippingSettings) -> float:
    """Of the pixels, (H, W, 3) uint8, how many are as bright as can be in a channel, in [0, 1]."""
    brightest = brightest_channel(photo[::2, ::2])
    return float(np.count_nonzero(brightest >= settings.value)) / max(brightest.size, 1)


def is_clipped(photo: UInt8Array, settings: ClippingSettings) -> bool:
    """Whether many of the pixels, (H, W, 3) uint8, are as bright as can be in a channel."""
    return clipped_share(photo, settings) > settings.min_share


def is_overexposed(photo: UInt8Array, settings: ClippingSettings) -> bool:
    """Whether so many are that features, and luminance, miss much of what is there."""
    return clipped_share(photo, settings) > settings.min_share_matched


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
    size = max(1, shown.shape[1] // _BLOCK), max(1, shown.shape[0] // _BLOCK)

    def of_blocks(image: Float32Array | UInt8Array) -> Float32Array:
        means = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        return np.asarray(means, np.float32)

    def share_above(image: Float32Array | UInt8Array, limit: float) -> Float32Array:
        return of_blocks(np.uint8(255) * (image > limit).view(np.uint8)) / np.float32(255.0)

    rendered, seen = of_blocks(render), of_blocks(photo.astype(np.float32)) / np.float32(255.0)
    whole = of_blocks(shown.astype(np.float32))[..., None] > 0.9
    clipped = share_above(photo, settings.value - 0.5)
    # The mean of a block that is clipped in part follows neither line.
    usable = whole & ((clipped < 0.02) | (clipped > 0.98))
    if np.count_nonzero(usable) < _ENOUGH:
        return None
    fits = [_fit(rendered[usable], seen[usable], gain) for gain in (1.0, 2.0)]
    _, gain, bias = min(fits)  # where all is clipped, no slope
    # Among blocks that are nearly white in the map, those that happen to be darker in the photo are
    # less often clipped: the gain is too small. So blocks are chosen again, by the render alone.
    for _ in range(_CHOICES):
        if gain <= 0:
            break
        usable = whole & (share_above(render, (_SURELY_DARKER - bias) / gain) < 0.02)
        if np.count_nonzero(usable) < _ENOUGH:
            break
        _, gain, bias = _fit(rendered[usable], seen[usable], gain, bias)
    return (gain, bias) if gain > 0 else None


def _fit(
    rendered: Float32Array, seen: Float32Array, gain: float, bias: float = 0.0
) -> tuple[float, float, float]:
    """Cost, gain and bias by Gauss-Newton steps under the soft L1 loss."""
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


def darker_channels(image: UInt8Array | Float32Array) -> Float32Array:
    """Grey, (H, W), of (H, W, 3): between the mean of the channels and the darkest of them (a soft
    minimum); bytes become [0, 1].

    Where two of three channels are clipped, luminance hardly shows what the third one tells, and
    its gradients drown among those of pixels that are not clipped.
    """
    per_byte = _DARKER / 255.0 if image.dtype == np.uint8 else _DARKER
    weights = cv2.exp(np.float32(-per_byte) * image.astype(np.float32))
    mean = cv2.transform(np.asarray(weights), np.full((1, 3), 1.0 / 3.0, dtype=np.float32))
    return np.asarray(cv2.log(mean) * np.float32(-1.0 / _DARKER), dtype=np.float32)


def without_flat_white(level: AnchorLevel) -> AnchorLevel:
    """Without pixels around which all is white: they show no motion, and their residuals, all
    zero, would make those of the others look far off."""
    shows_something = (level.image < _WHITE).astype(np.uint8)
    # A gradient is made of 3x3 pixels, and needs these to be valid.
    near = cv2.dilate(shows_something, np.ones((5, 5), dtype=np.uint8))
    return replace(level, valid=level.valid & (near > 0))
