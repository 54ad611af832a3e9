# SPDX-License-Identifier: Apache-2.0
"""Parts of a photo that show something else than the map: what has been moved, or has come, since.

A robust loss leaves single pixels out. Where half of the photo has changed, most residuals are of
what has changed, and nothing stands out from them. So whole regions that do not look like the map
are found at a pose that matches have determined, and left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gscpe.arrays import BoolArray
from gscpe.photos import Photo, luminance
from gscpe.photos.photo import shrink
from gscpe.refinement.visibility import OPAQUE
from gscpe.render import RenderedView, correlation_map

_ALIKE = 0.3
"""Local correlation below which a place shows something else."""
_LEAST = 0.1
"""Share of the photo that must be left."""


def without_changes(photo: Photo, view: RenderedView) -> Photo | None:
    """The photo without the places that do not look like the map; None where hardly anything
    would be left, or nothing left out.

    Args:
        photo: pinhole photo.
        view: the map as its camera sees it, from its pose to about a pixel.
    """
    height, width = photo.rgb.shape[:2]
    size = max(1, width // 2), max(1, height // 2)
    shown = view.opacity >= OPAQUE
    if photo.valid is not None:
        shown &= photo.valid
    correlation = correlation_map(
        shrink(luminance(view.rgb), *size),
        shrink(luminance(photo.rgb), *size),
        shrink(shown.astype(np.float32), *size) > 0.99,
    )
    with np.errstate(invalid="ignore"):
        alike = ~(correlation < _ALIKE)  # also where there is nothing to compare
    valid = _enlarged(alike, width, height)
    if photo.valid is not None:
        valid &= photo.valid
    share = np.count_nonzero(valid & shown) / shown.size
    if alike.all() or share < _LEAST:
        return None
    return replace(photo, valid=valid)


def _enlarged(mask: BoolArray, width: int, height: int) -> BoolArray:
    """Twice as large; an odd last row or column is that before it."""
    twice = mask.repeat(2, axis=0).repeat(2, axis=1)
    rows, columns = height - twice.shape[0], width - twice.shape[1]
    return np.asarray(np.pad(twice, ((0, rows), (0, columns)), mode="edge"))
