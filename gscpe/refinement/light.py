# SPDX-License-Identifier: Apache-2.0
"""How a render must be exposed and lit to look like the photo, beyond one gain and one bias."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gscpe.arrays import BoolArray, Float32Array
from gscpe.photos import Photo, luminance
from gscpe.photos.photo import brightest_channel
from gscpe.ranges import check_kinds
from gscpe.refinement.exposure import (
    ClippingSettings,
    darker_channels,
    expose,
    fit_exposure,
    is_clipped,
    is_overexposed,
)
from gscpe.refinement.illumination import IlluminationSettings, fit_illumination
from gscpe.render import RenderedView


@dataclass(frozen=True)
class LightSettings:
    """Of overexposed photos (``clipping``) and of those that are lit unevenly."""

    clipping: ClippingSettings = field(default_factory=ClippingSettings)
    illumination: IlluminationSettings = field(default_factory=IlluminationSettings)

    def __post_init__(self) -> None:
        check_kinds(self, clipping=ClippingSettings, illumination=IlluminationSettings)


@dataclass(frozen=True, eq=False)
class LitRender:
    """A render in grey, as the photo's light and exposure make it.

    Attributes:
        image: (H, W) float32.
        changed: whether it is another than the render's own.
        clipped: whether its brightest parts are.
        gain, bias: image = gain * render + bias, where it is not clipped; of uneven light, the
            mean.
    """

    image: Float32Array
    changed: bool
    clipped: bool
    gain: float = 1.0
    bias: float = 0.0


class PhotoLight:
    """What is known of a photo's light before it is compared with renders.

    Attributes:
        grey: (H, W) float32 in [0, 1], of the photo: what is compared. Its luminance, unless much
            of it is clipped.
    """

    def __init__(self, photo: Photo, settings: LightSettings) -> None:
        self._photo = photo
        self._settings = settings
        self._clipped = is_clipped(photo.rgb, settings.clipping)
        overexposed = self._clipped and is_overexposed(photo.rgb, settings.clipping)
        self._in_grey = darker_channels if overexposed else luminance
        usable = brightest_channel(photo.rgb) < settings.clipping.value
        self._usable = usable if photo.valid is None else usable & photo.valid
        self.grey = self._in_grey(photo.rgb)

    def of(self, view: RenderedView, mask: BoolArray) -> LitRender:
        """A render, from about the same pose, as this light shows it where ``mask``, (H, W),
        holds."""
        exposure = None
        if self._clipped:
            exposure = fit_exposure(view.rgb, self._photo.rgb, mask, self._settings.clipping)
        gain, bias = exposure or (1.0, 0.0)
        image = self._in_grey(view.rgb if exposure is None else expose(view.rgb, gain, bias))
        uneven = fit_illumination(
            image, self.grey, mask & self._usable, self._settings.illumination
        )
        if uneven is None:
            return LitRender(image, exposure is not None, exposure is not None, gain, bias)
        mean = float(np.mean(uneven))
        return LitRender(image * uneven, True, exposure is not None, mean * gain, mean * bias)
