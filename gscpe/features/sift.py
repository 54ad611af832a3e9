# SPDX-License-Identifier: Apache-2.0
"""RootSIFT (Arandjelovic and Zisserman, CVPR 2012) through OpenCV."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array, UInt8Array
from gscpe.ranges import check_numbers, check_whole


@dataclass(frozen=True, eq=False)
class LocalFeatures:
    """Keypoints and descriptors of one image.

    Attributes:
        pixels: (N, 2) float64 positions, the centre of the top-left pixel at (0.5, 0.5).
        descriptors: (N, 128) float32, of unit length.
    """

    pixels: Float64Array
    descriptors: Float32Array

    def __len__(self) -> int:
        return len(self.pixels)


@dataclass(frozen=True)
class SiftSettings:
    """At most this many features, strongest first, and the contrast below which none is."""

    max_features: int = 4000
    contrast_threshold: float = 0.02

    def __post_init__(self) -> None:
        check_whole(self, "max_features", least=1)
        check_numbers(self, "contrast_threshold", least=0)


def extract_sift(
    rgb: UInt8Array, settings: SiftSettings, valid: BoolArray | None = None
) -> LocalFeatures:
    """RootSIFT features of an (H, W, 3) uint8 RGB image where ``valid``, (H, W), holds."""
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    # Without precise upscaling, OpenCV's SIFT is biased by a quarter of a pixel.
    detector = cv2.SIFT_create(  # type: ignore[attr-defined]
        nfeatures=settings.max_features,
        contrastThreshold=settings.contrast_threshold,
        enable_precise_upscale=True,
    )
    mask = None if valid is None else valid.astype(np.uint8) * 255
    keypoints, descriptors = detector.detectAndCompute(grey, mask)
    if descriptors is None or len(keypoints) == 0:
        return LocalFeatures(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.float32))
    pixels = np.array([keypoint.pt for keypoint in keypoints], dtype=np.float64) + 0.5
    sums = np.maximum(np.abs(descriptors).sum(axis=1, keepdims=True), 1e-12)
    return LocalFeatures(pixels, np.sqrt(descriptors / sums).astype(np.float32))
