# SPDX-License-Identifier: Apache-2.0
"""What matching sees of photos that are too dark or overexposed; and those that show nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gscpe.arrays import Float32Array, UInt8Array
from gscpe.coarse import LikePhoto
from gscpe.photos import Photo
from gscpe.photos.photo import brightest_channel
from gscpe.refinement.exposure import ClippingSettings, expose, fit_exposure, is_overexposed
from gscpe.refinement.visibility import OPAQUE
from gscpe.render import RenderedView

_DARK, _BRIGHT = 40, 250
_SPARKS = 0.001  # share of the pixels that may be otherwise: sensor noise, reflections

_BLACK = 10
"""What is not brighter shows nothing: a photo with a twentieth of the light still shows more."""
_MOST = 0.5
_LONGER, _SHORTER = "expose it longer", "expose it for a shorter time"

_DIM, _WELL_LIT = 150, 235
"""What is brightest in a photo that is brightened, at most; and what it becomes."""


def well_lit(photo: Photo) -> Photo:
    """The photo as features see it: a dim one, where SIFT's contrasts would be too small, times a
    factor that makes its brightest pixels as bright as usual. (Measured on photos with a tenth and
    a twentieth of the light: equalizing the histogram, or local mean and contrast, lost matches.)
    """
    pixels = brightest_channel(photo.rgb)
    values = pixels.ravel() if photo.valid is None else pixels[photo.valid]
    if not len(values):
        return photo
    brightest = _quantile(values, 0.98)
    if not 0 < brightest <= _DIM:
        return photo
    table = np.rint(np.minimum(_WELL_LIT / brightest * np.arange(256), 255.0)).astype(np.uint8)
    return replace(photo, rgb=table[photo.rgb])


def exposed_like(photo: Photo, settings: ClippingSettings) -> LikePhoto | None:
    """How a render is matched with an overexposed photo: exposed and clipped likewise. Where it
    is clipped, the photo lacks features, and edges seem to lie beside where they are. None for
    other photos."""
    if not is_overexposed(photo.rgb, settings):
        return None

    def like_photo(view: RenderedView) -> Float32Array:
        shown = view.opacity >= OPAQUE
        if photo.valid is not None:
            shown = shown & photo.valid
        exposure = fit_exposure(view.rgb, photo.rgb, shown, settings)
        return view.rgb if exposure is None else expose(view.rgb, *exposure)

    return like_photo


def _quantile(values: UInt8Array, share: float) -> float:
    """As :func:`numpy.quantile`, which sorts; bytes need only be counted."""
    up_to = np.cumsum(np.bincount(values, minlength=256))
    place = share * (len(values) - 1)
    below, above = np.searchsorted(up_to, [np.floor(place), np.ceil(place)], side="right")
    return float(below + (place - np.floor(place)) * (above - below))


def trouble_with_light(photo: Photo) -> str | None:
    """Says that a photo, or more than half of it, is almost black or almost white, and what to do;
    None where it is neither."""
    seen = photo.rgb if photo.valid is None else photo.rgb[photo.valid]
    pixels = seen.reshape(-1, 3)
    if not len(pixels):
        return "the whole photo is masked: give a mask that leaves something to match"
    most, least = pixels.max(axis=1), pixels.min(axis=1)
    brightest = float(np.quantile(most, 1.0 - _SPARKS, method="lower"))
    darkest = float(np.quantile(least, _SPARKS, method="higher"))
    if brightest <= _DARK:
        return f"the photo is almost black (brightest value {brightest:.0f} of 255): {_LONGER}"
    if darkest >= _BRIGHT:
        return f"the photo is almost white (darkest value {darkest:.0f} of 255): {_SHORTER}"
    dark, bright = float(np.mean(most <= _BLACK)), float(np.mean(least >= _BRIGHT))
    if dark > _MOST:
        return f"{dark:.0%} of the photo is black: {_LONGER}, or uncover the lens"
    if bright > _MOST:
        return f"{bright:.0%} of the photo is white: {_SHORTER}"
    return None
