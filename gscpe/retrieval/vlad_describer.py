# SPDX-License-Identifier: Apache-2.0
"""VLAD of an image: of RootSIFT, or of XFeat."""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, UInt8Array
from gscpe.features.sift import SiftSettings, extract_sift
from gscpe.features.xfeat import XFeat, XFeatFeatures
from gscpe.retrieval.vlad import aggregate

LONGEST_SIDE = 320
"""Images are shrunk to this many pixels before RootSIFT: fine texture does not help to
recognize a place, and differs between photos and renders."""

MOST_XFEATS = 1000
"""Of the full-size image, the best first. From 500 to 2048, retrieval hardly changes
(tools/bench_retrieval.py)."""

_SIFT = SiftSettings(max_features=1000, contrast_threshold=0.02)


class LocalDescriptors(Protocol):
    """Local descriptors, (N, C) float32; arguments as GlobalDescriber.describe."""

    def __call__(
        self, rgb: UInt8Array, local: XFeatFeatures | None = None, valid: BoolArray | None = None
    ) -> Float32Array: ...


def rootsift(
    rgb: UInt8Array, local: XFeatFeatures | None = None, valid: BoolArray | None = None
) -> Float32Array:
    """RootSIFT, (N, 128), of the shrunk image; masks and XFeat's features are not looked at."""
    height, width = rgb.shape[:2]
    scale = LONGEST_SIDE / max(height, width)
    if scale < 1.0:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return extract_sift(rgb, _SIFT).descriptors


def xfeat(network: XFeat | None = None) -> LocalDescriptors:
    """XFeat, (N, 64), of the image as large as it is: matching needs those features too.

    Raises:
        ModelError: XFeat is not installed.
        MissingDependencyError: onnxruntime is not installed.
    """
    opened = network or XFeat()

    def descriptors(
        rgb: UInt8Array, local: XFeatFeatures | None = None, valid: BoolArray | None = None
    ) -> Float32Array:
        found = opened.detect(rgb, MOST_XFEATS, valid=valid) if local is None else local
        return found.descriptors[:MOST_XFEATS]

    return descriptors


class VladDescriber:
    """Implements :class:`gscpe.retrieval.GlobalDescriber` with a vocabulary, (K, C)."""

    def __init__(self, local_descriptors: LocalDescriptors, vocabulary: Float32Array) -> None:
        self.local_descriptors = local_descriptors
        self.vocabulary = vocabulary

    def describe(
        self, rgb: UInt8Array, local: XFeatFeatures | None = None, valid: BoolArray | None = None
    ) -> Float32Array:
        return aggregate(self.local_descriptors(rgb, local, valid), self.vocabulary)
