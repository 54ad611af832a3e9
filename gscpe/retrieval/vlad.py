# SPDX-License-Identifier: Apache-2.0
"""VLAD (Jegou et al., CVPR 2010), power- and L2-normalized.

The vocabulary is learned from the map's own reference photos, so no model is downloaded.
It is not whitened: that made retrieval worse wherever it was tried.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from gscpe.arrays import Float32Array
from gscpe.errors import SettingsError


@dataclass(frozen=True)
class VocabularySettings:
    """How visual words are learned.

    Attributes:
        words: how many.
        training_descriptors: at most this many are clustered.
    """

    words: int = 64
    training_descriptors: int = 20_000

    def __post_init__(self) -> None:
        if self.words < 1 or self.training_descriptors < 1:
            raise SettingsError("a vocabulary needs at least one word and one descriptor")


def learn_vocabulary(
    descriptors: Sequence[Float32Array], settings: VocabularySettings, seed: int = 0
) -> Float32Array:
    """Visual words, (K, C) float32, by k-means over one (N, C) array of local descriptors a photo.

    K is smaller than asked when there are fewer than eight descriptors a word, or fewer different
    ones than words.
    """
    rng = np.random.default_rng(seed)
    stacked = np.concatenate(descriptors)
    if len(stacked) > settings.training_descriptors:
        chosen = rng.choice(len(stacked), settings.training_descriptors, replace=False)
        stacked = stacked[np.sort(chosen)]
    words = max(1, min(settings.words, len(stacked) // 8))
    if len(stacked) < 2:
        return np.zeros((1, stacked.shape[1]), dtype=np.float32)
    from scipy.cluster.vq import kmeans2

    centres, _ = kmeans2(stacked, _first_words(stacked, words, rng), iter=20, minit="matrix")
    return np.asarray(centres, dtype=np.float32)


def _first_words(descriptors: Float32Array, count: int, rng: np.random.Generator) -> Float32Array:
    """Descriptors, (K, C), that k-means begins with, far from each other (k-means++: Arthur and
    Vassilvitskii, SODA 2007). SciPy's own compares all words again for each new one."""
    from scipy.spatial.distance import cdist

    chosen = [int(rng.integers(len(descriptors)))]
    squared = np.full(len(descriptors), np.inf)
    while len(chosen) < count:
        latest = cdist(descriptors[chosen[-1:]], descriptors, "sqeuclidean")[0]
        squared = np.minimum(squared, latest)
        total = squared.sum()
        if not total > 0:
            break  # there are no more different ones
        drawn = np.searchsorted((squared / total).cumsum(), rng.uniform())
        chosen.append(min(int(drawn), len(descriptors) - 1))
    return descriptors[chosen]


def aggregate(descriptors: Float32Array, vocabulary: Float32Array) -> Float32Array:
    """The VLAD, (K * C,) float32 of unit length, of an image's local descriptors, (N, C).

    All zero for an image without features.
    """
    residuals = np.zeros(vocabulary.shape, dtype=np.float32)
    if len(descriptors):
        from scipy.cluster.vq import vq

        words, _ = vq(descriptors, vocabulary)
        np.add.at(residuals, words, descriptors - vocabulary[words])
    vlad = residuals.ravel()
    vlad = np.sign(vlad) * np.sqrt(np.abs(vlad))
    return np.asarray(vlad / max(float(np.linalg.norm(vlad)), 1e-12), dtype=np.float32)
