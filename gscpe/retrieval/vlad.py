"""VLAD of RootSIFT (Jegou et al., CVPR 2010), power- and L2-normalized.

The vocabulary is learned from the map's own reference photos, so no model is downloaded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import cv2
import numpy as np
from scipy.cluster.vq import kmeans2, vq

from gscpe.arrays import Float32Array, UInt8Array
from gscpe.features import SiftSettings, extract_sift


@dataclass(frozen=True)
class VladSettings:
    """How an image is described.

    Attributes:
        words: size of the vocabulary.
        longest_side: images are shrunk to this many pixels first; fine texture does not
            help to recognize a place and differs between photos and renders.
        training_descriptors: at most this many are clustered.
    """

    words: int = 64
    longest_side: int = 320
    training_descriptors: int = 20_000


_SIFT = SiftSettings(max_features=1000, contrast_threshold=0.02)


def local_descriptors(rgb: UInt8Array, settings: VladSettings) -> Float32Array:
    """The RootSIFT descriptors, (N, 128), that VLAD is made of."""
    height, width = rgb.shape[:2]
    scale = settings.longest_side / max(height, width)
    if scale < 1.0:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return extract_sift(rgb, _SIFT).descriptors


def learn_vocabulary(
    descriptors: Sequence[Float32Array], settings: VladSettings, seed: int = 0
) -> Float32Array:
    """Visual words, (K, 128), by k-means over the references' descriptors.

    K is smaller than asked when there are fewer than eight descriptors a word.
    """
    rng = np.random.default_rng(seed)
    stacked = np.concatenate([*descriptors, np.zeros((0, 128), dtype=np.float32)])
    if len(stacked) > settings.training_descriptors:
        chosen = rng.choice(len(stacked), settings.training_descriptors, replace=False)
        stacked = stacked[np.sort(chosen)]
    words = max(1, min(settings.words, len(stacked) // 8))
    if len(stacked) < 2:
        return np.zeros((1, 128), dtype=np.float32)
    centres, _ = kmeans2(stacked, words, iter=20, minit="++", rng=rng)
    return np.asarray(centres, dtype=np.float32)


def describe_image(descriptors: Float32Array, vocabulary: Float32Array) -> Float32Array:
    """The VLAD, (K * 128,) float32 of unit length, of an image's local descriptors, (N, 128).

    All zero for an image without features.
    """
    residuals = np.zeros(vocabulary.shape, dtype=np.float32)
    if len(descriptors):
        words, _ = vq(descriptors, vocabulary)
        np.add.at(residuals, words, descriptors - vocabulary[words])
    vlad = residuals.ravel()
    vlad = np.sign(vlad) * np.sqrt(np.abs(vlad))
    return np.asarray(vlad / max(float(np.linalg.norm(vlad)), 1e-12), dtype=np.float32)
