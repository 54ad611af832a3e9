# SPDX-License-Identifier: Apache-2.0
"""Whether a photo is too dark or too bright to show anything."""

from __future__ import annotations

import numpy as np

from gscpe.scene import Photo

_DARK, _BRIGHT = 40, 250
_SPARKS = 0.001  # share of the pixels that may be otherwise: sensor noise, reflections


def trouble_with_light(photo: Photo) -> str | None:
    """Says that a photo is almost black or almost white; None where it is neither."""
    seen = photo.rgb if photo.valid is None else photo.rgb[photo.valid]
    pixels = seen.reshape(-1, 3)
    if not len(pixels):
        return "the whole photo is masked: nothing is left to match"
    brightest = float(np.quantile(pixels.max(axis=1), 1.0 - _SPARKS, method="lower"))
    darkest = float(np.quantile(pixels.min(axis=1), _SPARKS, method="higher"))
    if brightest <= _DARK:
        return f"the photo is almost black (brightest value {brightest:.0f} of 255)"
    if darkest >= _BRIGHT:
        return f"the photo is almost white (darkest value {darkest:.0f} of 255)"
    return None
