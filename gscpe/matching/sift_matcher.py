"""RootSIFT with Lowe's ratio test and a mutual check."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gscpe.arrays import BoolArray, Float32Array, UInt8Array
from gscpe.errors import SettingsError
from gscpe.features import LocalFeatures, SiftSettings, extract_sift
from gscpe.matching.protocol import Matches


@dataclass(frozen=True)
class SiftMatcherSettings:
    """Feature extraction, and the largest ratio of best to second-best distance."""

    sift: SiftSettings = field(default_factory=SiftSettings)
    ratio: float = 0.85

    def __post_init__(self) -> None:
        if not 0 < self.ratio <= 1:
            raise SettingsError(f"ratio must lie in (0, 1], not {self.ratio}")


class SiftMatcher:
    """Implements :class:`gscpe.matching.Matcher` without any model."""

    def __init__(self, settings: SiftMatcherSettings | None = None) -> None:
        self._settings = settings or SiftMatcherSettings()

    def prepare(self, rgb: UInt8Array, valid: BoolArray | None) -> LocalFeatures:
        return extract_sift(rgb, self._settings.sift, valid)

    def match(self, photo: LocalFeatures, render: LocalFeatures) -> Matches:
        if len(photo) < 2 or len(render) < 2:
            empty = np.zeros((0, 2))
            return Matches(empty, empty, np.zeros(0, dtype=np.float32))
        similarity = photo.descriptors @ render.descriptors.T
        rows = np.arange(len(photo))
        best = similarity.argmax(axis=1)
        mutual = similarity.argmax(axis=0)[best] == rows
        best_similarity = similarity[rows, best]
        similarity[rows, best] = -1.0
        second_similarity = similarity.max(axis=1)
        ratio = _distance(best_similarity) / np.maximum(_distance(second_similarity), 1e-6)
        kept = np.flatnonzero(mutual & (ratio < self._settings.ratio))
        return Matches(
            photo_pixels=photo.pixels[kept],
            render_pixels=render.pixels[best[kept]],
            scores=np.asarray(1.0 - ratio[kept], dtype=np.float32),
        )


def _distance(cosine: Float32Array) -> Float32Array:
    """Euclidean distance of unit vectors."""
    return np.asarray(np.sqrt(np.maximum(2.0 - 2.0 * cosine, 0.0)), dtype=np.float32)
