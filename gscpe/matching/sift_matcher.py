# SPDX-License-Identifier: Apache-2.0
"""RootSIFT with Lowe's ratio test and a mutual check, polished to sub-pixel."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import NoneType

import numpy as np

from gscpe.arrays import BoolArray, Float32Array, UInt8Array
from gscpe.features import LocalFeatures, SiftSettings, extract_sift
from gscpe.matching.nearest import mutual_nearest
from gscpe.matching.polish import PolishSettings, for_polishing, polish
from gscpe.matching.protocol import Matches, no_matches
from gscpe.ranges import check_kinds, check_numbers


@dataclass(frozen=True)
class SiftMatcherSettings:
    """How images are matched.

    Attributes:
        sift: feature extraction.
        ratio: largest ratio of best to second-best distance.
        polish: None leaves the matches where SIFT put them.
    """

    sift: SiftSettings = field(default_factory=SiftSettings)
    ratio: float = 0.85
    polish: PolishSettings | None = field(default_factory=PolishSettings)

    def __post_init__(self) -> None:
        check_numbers(self, "ratio", above=0, most=1)
        check_kinds(self, sift=SiftSettings, polish=(PolishSettings, NoneType))


@dataclass(frozen=True, eq=False)
class SiftImage:
    """Features of an image, and what polishing needs of it, (H, W) uint8 or None."""

    features: LocalFeatures
    normalized: UInt8Array | None


class SiftMatcher:
    """Implements :class:`gscpe.matching.Matcher` without any model."""

    def __init__(self, settings: SiftMatcherSettings | None = None) -> None:
        self._settings = settings or SiftMatcherSettings()

    def prepare(self, rgb: UInt8Array, valid: BoolArray | None) -> SiftImage:
        return SiftImage(
            extract_sift(rgb, self._settings.sift, valid),
            for_polishing(rgb, self._settings.polish),
        )

    def match(self, photo: SiftImage, render: SiftImage) -> Matches:
        if len(photo.features) < 2 or len(render.features) < 2:
            return no_matches()
        similarity = photo.features.descriptors @ render.features.descriptors.T
        rows, columns = mutual_nearest(similarity)
        best = similarity[rows, columns]
        similarity[rows, columns] = -1.0
        second = similarity[rows].max(axis=1)
        ratio = _distance(best) / np.maximum(_distance(second), 1e-6)
        kept = ratio < self._settings.ratio
        photo_pixels = photo.features.pixels[rows[kept]]
        render_pixels = render.features.pixels[columns[kept]]
        render_pixels = polish(
            photo.normalized, render.normalized, photo_pixels, render_pixels, self._settings.polish
        )
        scores = np.asarray(1.0 - ratio[kept], dtype=np.float32)
        return Matches(photo_pixels, render_pixels, scores)


def _distance(cosine: Float32Array) -> Float32Array:
    """Euclidean distance of unit vectors."""
    return np.asarray(np.sqrt(np.maximum(2.0 - 2.0 * cosine, 0.0)), dtype=np.float32)
