# SPDX-License-Identifier: Apache-2.0
"""How well an anchor, brought to the photo, looks like it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array, IntArray
from gscpe.geometry.projection import unproject_image
from gscpe.refinement.products import sums_by_label
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.sampling import sample_bilinear
from gscpe.refinement.template import Template, residuals_of, warp
from gscpe.render import local_correlation

_TEXTURE = 0.02
"""Standard deviation of luminance below which a block has nothing to compare."""
_FEWEST = 12
"""Pixels that a block needs."""


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


@dataclass(frozen=True)
class BlockAgreement:
    """How alike the blocks of an anchor and of a photo look, whatever the exposure of each.

    Attributes:
        correlation: its mean over the blocks, in [-1, 1]; NaN where there is nothing to compare.
        alike: share of the blocks whose correlation is above one half, in [0, 1].
        overlap: share of the anchor's pixels that are visible in the photo, in [0, 1].
    """

    correlation: float
    alike: float
    overlap: float


def block_agreement(
    template: Template, photo: ImageLevel, photo_from_anchor: Float64Array, blocks: IntArray
) -> BlockAgreement:
    """The agreement in a template's pixels alone: less exact than
    :func:`photometric_agreement`, but it takes a tenth of the time.

    Args:
        template: of the anchor.
        photo: at the same level.
        photo_from_anchor: (4, 4).
        blocks: (N,) number of each template pixel's block.
    """
    seen, usable = residuals_of(template, photo, photo_from_anchor, 0.0, 0.0)
    shown = template.intensities
    rows = np.stack([np.ones_like(shown), shown, seen, shown * shown, seen * seen, shown * seen])
    sums = sums_by_label(blocks, rows * usable)
    enough = sums[0] >= _FEWEST
    of_shown, of_seen, shown_squared, seen_squared, both = sums[1:] / np.maximum(sums[0], 1.0)
    var_shown = np.maximum(shown_squared - of_shown**2, 0.0)
    var_seen = np.maximum(seen_squared - of_seen**2, 0.0)
    common = both - of_shown * of_seen
    enough &= np.maximum(var_shown, var_seen) > _TEXTURE**2
    overlap = float(np.count_nonzero(usable)) / max(len(usable), 1)
    if not np.any(enough):
        return BlockAgreement(float("nan"), 0.0, overlap)
    # A block that is flat in one image alone does not agree, and its deviation may be zero.
    least = (0.5 * _TEXTURE) ** 2
    spread = np.sqrt(np.maximum(var_shown, least) * np.maximum(var_seen, least))
    correlation = (common / spread)[enough]
    weights = sums[0][enough] / sums[0][enough].sum()
    alike = float(weights[correlation > 0.5].sum())
    return BlockAgreement(float(weights @ correlation), alike, overlap)
