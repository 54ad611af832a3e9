# SPDX-License-Identifier: Apache-2.0
"""XFeat (Potje et al., CVPR 2024): learned keypoints and descriptors, through onnxruntime."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import BoolArray, Float32Array, Float64Array, IntArray
from gscpe.errors import PhotoError, SettingsError
from gscpe.models import Network, Signature, TensorSpec, model_path

SIGNATURE = Signature(
    inputs=(TensorSpec("image", (1, 1, None, None)),),
    outputs=(
        TensorSpec("keypoints", (None, None)),
        TensorSpec("reliability", (None, None)),
        TensorSpec("descriptors", (None, None, 64)),
    ),
)
_MULTIPLE = 32
_SUPPRESSION = 5
_CUBIC = -0.75


@dataclass(frozen=True, eq=False)
class XFeatFeatures:
    """Keypoints and descriptors of one image, best first.

    Attributes:
        pixels: (N, 2) float64, centres of pixels; the top-left one's is (0.5, 0.5).
        scores: (N,) float32 in (0, 1], the probability of a keypoint times its reliability.
        descriptors: (N, 64) float32, of unit length.
    """

    pixels: Float64Array
    scores: Float32Array
    descriptors: Float32Array

    def __len__(self) -> int:
        return len(self.scores)


class XFeat:
    """The opened network."""

    def __init__(self, path: str | Path | None = None, threads: int | None = None) -> None:
        """Opens ``path``, or the installed model.

        Raises:
            ModelError: it is not installed, damaged, or another network.
            MissingDependencyError: onnxruntime is not installed.
        """
        path = model_path("xfeat", "xfeat.onnx") if path is None else path
        self._network = Network(path, SIGNATURE, threads)

    def detect(
        self,
        image: NDArray[Any],
        max_features: int = 4096,
        *,
        threshold: float = 0.05,
        valid: BoolArray | None = None,
    ) -> XFeatFeatures:
        """Features of an image.

        Args:
            image: (H, W) grey or (H, W, 3) RGB, uint8 or float32 in [0, 1].
            max_features: at most this many, the best.
            threshold: the least probability of a keypoint.
            valid: (H, W), where there may be keypoints; None: everywhere.

        Raises:
            PhotoError: the image is of another shape or type, or not finite.
            SettingsError: a setting is out of its range.
            ModelError: the network cannot be run.
        """
        if max_features < 1 or not 0 <= threshold < 1:
            raise SettingsError(
                "max_features must be positive and threshold in [0, 1), "
                f"not {max_features} and {threshold}"
            )
        grey = _grey(image)
        if valid is not None and valid.shape != grey.shape:
            raise PhotoError(f"the mask is of shape {valid.shape}, the image of {grey.shape}")
        padded = _pad(_standardized(grey))
        probability, reliability, descriptors = self._network.run({"image": padded[None, None]})
        columns, rows = _peaks(probability, grey.shape, threshold, valid)
        x, y = _on_map(columns, padded.shape[1]), _on_map(rows, padded.shape[0])
        scores = probability[rows, columns] * _sample_bilinear(reliability, x, y)
        best = np.argsort(-scores, kind="stable")[:max_features]
        best = best[scores[best] > 0]
        return XFeatFeatures(
            pixels=np.stack([columns[best], rows[best]], axis=1).astype(np.float64) + 0.5,
            scores=scores[best],
            descriptors=_sample_bicubic(descriptors, x[best], y[best]),
        )


def _grey(image: NDArray[Any]) -> Float32Array:
    """The mean of the channels, as the network was trained."""
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or image.size == 0:
        raise PhotoError(f"an image must be (H, W) or (H, W, 3), not {image.shape}")
    if image.dtype not in (np.uint8, np.float32):
        raise PhotoError(f"an image must be uint8 or float32, not {image.dtype}")
    grey = (
        image.astype(np.float32)
        if image.ndim == 2
        else cv2.transform(image.astype(np.float32), np.full((1, 3), 1 / 3, dtype=np.float32))
    )
    if image.dtype == np.uint8:
        grey = grey / np.float32(255)
    if not np.all(np.isfinite(grey)):
        raise PhotoError("the image holds values that are not finite")
    return np.asarray(grey, dtype=np.float32)


def _standardized(grey: Float32Array) -> Float32Array:
    """Mean 0 and variance 1, but for images without any contrast."""
    mean, deviation = (float(each[0, 0]) for each in cv2.meanStdDev(grey))
    return np.asarray((grey - mean) / np.sqrt(deviation**2 + 1e-5), dtype=np.float32)


def _pad(grey: Float32Array) -> Float32Array:
    """Continues the right and lower border up to a multiple of 32 pixels. Unlike scaling to
    such a size, this leaves every pixel where and what it is."""
    height, width = grey.shape
    down, right = -height % _MULTIPLE, -width % _MULTIPLE
    if not (down or right):
        return grey
    return np.asarray(cv2.copyMakeBorder(grey, 0, down, 0, right, cv2.BORDER_REPLICATE))


def _peaks(
    probability: Float32Array, shape: tuple[int, ...], threshold: float, valid: BoolArray | None
) -> tuple[IntArray, IntArray]:
    """Columns and rows of the local maxima among 5 x 5 pixels that pass the threshold."""
    window = np.ones((_SUPPRESSION, _SUPPRESSION), dtype=np.uint8)
    peaks = (probability > threshold) & (probability == cv2.dilate(probability, window))
    # The original gives keypoints in the last row and column no score.
    peaks[-1], peaks[:, -1] = False, False
    inside = peaks[: shape[0], : shape[1]]
    rows, columns = np.nonzero(inside if valid is None else inside & valid)
    return columns, rows


def _on_map(index: IntArray, length: int) -> Float64Array:
    """Where a pixel is on a map of an eighth of its size, as the original samples it (up to
    1/16 of a cell off the true place, and the descriptors were trained so)."""
    return index.astype(np.float64) * (length / 8 / (length - 1)) - 0.5


def _sample_bilinear(values: Float32Array, x: Float64Array, y: Float64Array) -> Float32Array:
    """Zero outside, as the original has it."""
    return np.asarray(_sampling(values.shape, x, y, _linear_weights) @ values.ravel())


def _sample_bicubic(maps: Float32Array, x: Float64Array, y: Float64Array) -> Float32Array:
    """Unit vectors, (N, C), out of (H, W, C)."""
    flat = maps.reshape(-1, maps.shape[2])
    sampled = _sampling(maps.shape, x, y, _cubic_weights) @ flat
    length = np.sqrt(np.einsum("ij,ij->i", sampled, sampled))
    return np.asarray(sampled / np.maximum(length, 1e-12)[:, None], dtype=np.float32)


def _sampling(shape: tuple[int, ...], x: Float64Array, y: Float64Array, weights_of: Any) -> Any:
    """The (N, H * W) sparse matrix that interpolates at N places, with zeros outside."""
    from scipy.sparse import csr_array

    height, width = shape[:2]
    columns, x_weights = weights_of(x)
    rows, y_weights = weights_of(y)
    x_weights = np.where((columns >= 0) & (columns < width), x_weights, 0.0)
    y_weights = np.where((rows >= 0) & (rows < height), y_weights, 0.0)
    columns, rows = np.clip(columns, 0, width - 1), np.clip(rows, 0, height - 1)
    indices = (rows[:, :, None] * width + columns[:, None, :]).reshape(-1)
    weights = (y_weights[:, :, None] * x_weights[:, None, :]).astype(np.float32).reshape(-1)
    ends = np.arange(len(x) + 1) * (rows.shape[1] * columns.shape[1])
    return csr_array((weights, indices, ends), shape=(len(x), height * width))


def _linear_weights(position: Float64Array) -> tuple[IntArray, Float64Array]:
    first = np.floor(position)
    fraction = position - first
    indices = first.astype(np.intp)[:, None] + np.arange(2)
    return indices, np.stack([1 - fraction, fraction], axis=1)


def _cubic_weights(position: Float64Array) -> tuple[IntArray, Float64Array]:
    """Keys' cubic convolution with the slope that PyTorch uses."""
    first = np.floor(position)
    indices = first.astype(np.intp)[:, None] + np.arange(-1, 3)
    distance = np.abs(position[:, None] - indices)
    near = ((_CUBIC + 2) * distance - (_CUBIC + 3)) * distance**2 + 1
    far = _CUBIC * (((distance - 5) * distance + 8) * distance - 4)
    return indices, np.where(distance <= 1, near, far)
