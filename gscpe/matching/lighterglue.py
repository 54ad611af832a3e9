# SPDX-License-Identifier: Apache-2.0
"""LighterGlue: LightGlue (Lindenberger et al., ICCV 2023) for XFeat, through onnxruntime."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gscpe.arrays import Float32Array, IntArray
from gscpe.errors import SettingsError
from gscpe.features.xfeat import XFeatFeatures
from gscpe.models import Network, Signature, TensorSpec, model_path

SIGNATURE = Signature(
    inputs=(
        TensorSpec("keypoints_a", (None, 2)),
        TensorSpec("descriptors_a", (None, 64)),
        TensorSpec("keypoints_b", (None, 2)),
        TensorSpec("descriptors_b", (None, 64)),
    ),
    outputs=(TensorSpec("log_scores", (None, None)),),
)


class LighterGlue:
    """The opened network."""

    def __init__(self, path: str | Path | None = None, threads: int | None = None) -> None:
        """Opens ``path``, or the installed model.

        Raises:
            ModelError: it is not installed, damaged, or another network.
            MissingDependencyError: onnxruntime is not installed.
        """
        path = model_path("xfeat", "lighterglue.onnx") if path is None else path
        self._network = Network(path, SIGNATURE, threads)

    def match(
        self,
        features_a: XFeatFeatures,
        size_a: tuple[int, int],
        features_b: XFeatFeatures,
        size_b: tuple[int, int],
        *,
        min_score: float = 0.1,
        max_features: int = 1024,
    ) -> tuple[IntArray, Float32Array]:
        """Matches of two images' features.

        Args:
            size_a, size_b: width and height of the images in pixels.
            min_score: the least probability of a match.
            max_features: only so many of either image, the best; time grows with the square.

        Returns:
            (M, 2) indices into either features, and (M,) float32 probabilities.

        Raises:
            SettingsError: a setting is out of its range.
            ModelError: the network cannot be run.
        """
        if not 0 <= min_score < 1 or max_features < 1 or min(*size_a, *size_b) < 1:
            raise SettingsError(
                "min_score must be in [0, 1), max_features and image sizes positive, "
                f"not {min_score}, {max_features}, {size_a} and {size_b}"
            )
        if len(features_a) == 0 or len(features_b) == 0:
            return np.zeros((0, 2), dtype=np.intp), np.zeros(0, dtype=np.float32)
        best_a, best_b = _best(features_a, max_features), _best(features_b, max_features)
        (log_scores,) = self._network.run(
            {
                "keypoints_a": _normalized(features_a, best_a, size_a),
                "descriptors_a": features_a.descriptors[best_a],
                "keypoints_b": _normalized(features_b, best_b, size_b),
                "descriptors_b": features_b.descriptors[best_b],
            }
        )
        rows = np.arange(len(best_a))
        partner = log_scores.argmax(axis=1)
        mutual = log_scores.argmax(axis=0)[partner] == rows
        scores = np.exp(log_scores[rows, partner])
        kept = np.flatnonzero(mutual & (scores > min_score))
        pairs = np.stack([best_a[kept], best_b[partner[kept]]], axis=1)
        return pairs, np.asarray(scores[kept], dtype=np.float32)


def _best(features: XFeatFeatures, count: int) -> IntArray:
    return np.argsort(-features.scores, kind="stable")[:count]


def _normalized(features: XFeatFeatures, chosen: IntArray, size: tuple[int, int]) -> Float32Array:
    """From the middle of the image in units of half its longer side; half a pixel up and left,
    for the network was trained on pixels counted from the first one's centre."""
    width, height = size
    pixels = features.pixels[chosen] - 0.5
    middle = np.array([width / 2, height / 2])
    return np.asarray((pixels - middle) / (max(width, height) / 2), dtype=np.float32)
