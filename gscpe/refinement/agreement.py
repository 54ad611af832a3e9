# SPDX-License-Identifier: Apache-2.0
"""How well an anchor, brought to the photo, looks like it."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.projection import unproject_image
from gscpe.refinement.lucas_kanade import warp
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.sampling import sample_bilinear
from gscpe.render import local_correlation


def photometric_agreement(
    anchor: AnchorLevel, photo: ImageLevel, photo_from_anchor: Float64Array
) -> tuple[float, float]:
    """Local correlation of an anchor and the photo warped to it, and their overlap.

    Returns:
        The correlation, in [-1, 1], NaN where there is nothing to compare; and the share of
        the anchor's pixels, in [0, 1], that are visible in the photo.
    """
    points = unproject_image(anchor.camera, anchor.depth)
    u, v, ahead = warp(points, photo_from_anchor, photo.camera)
    values, inside = sample_bilinear(photo.image, photo.valid, u, v)
    common = (inside & ahead).reshape(anchor.image.shape) & anchor.valid
    overlap = float(np.count_nonzero(common)) / common.size
    warped = values.reshape(anchor.image.shape)
    return local_correlation(anchor.image, warped, common), overlap
