# SPDX-License-Identifier: Apache-2.0
"""XFeat (Potje et al., CVPR 2024) as an ONNX graph: one grey image to a map of keypoints, of
their reliability, and of descriptors.

A pyramid of convolutions at 1/4 to 1/32 of the size, whose three coarsest levels are added
up at 1/8, gives descriptors and reliability. Keypoints come from another, shallow branch: it
sees the 64 pixels of each 8 x 8 cell and says which of them is one, or that none is.
"""

from __future__ import annotations

from typing import Mapping, NamedTuple

import numpy as np

from gscpe.models.graph import GraphWriter, Weights, take

CELL = 8
"""Pixels along a cell: of the keypoint branch, and of the maps at 1/8 of the size."""

DESCRIPTOR_LENGTH = 64
_EPSILON = 1e-5


class Convolution(NamedTuple):
    """Followed by batch normalization and ReLU, unless it is plain: then it has a bias."""

    inputs: int
    outputs: int
    kernel: int = 3
    stride: int = 1
    plain: bool = False


C = Convolution
BLOCKS: Mapping[str, tuple[Convolution, ...]] = {
    "block1": (C(1, 4), C(4, 8, stride=2), C(8, 8), C(8, 24, stride=2)),
    "block2": (C(24, 24), C(24, 24)),
    "block3": (C(24, 64, stride=2), C(64, 64), C(64, 64, kernel=1)),
    "block4": (C(64, 64, stride=2), C(64, 64), C(64, 64)),
    "block5": (C(64, 128, stride=2), C(128, 128), C(128, 128), C(128, 64, kernel=1)),
    "block_fusion": (C(64, 64), C(64, 64), C(64, 64, kernel=1, plain=True)),
    "heatmap_head": (C(64, 64, kernel=1), C(64, 64, kernel=1), C(64, 1, kernel=1, plain=True)),
    "keypoint_head": (
        *(C(64, 64, kernel=1), C(64, 64, kernel=1), C(64, 64, kernel=1)),
        C(64, 65, kernel=1, plain=True),
    ),
}
"""The convolutions of each block, which have these names in the checkpoint."""


def build_xfeat(weights: Weights, metadata: Mapping[str, str]) -> bytes:
    """The network as the bytes of an ``.onnx`` file.

    Input ``image`` (1, 1, H, W), H and W multiples of 32, of mean 0 and variance 1. (The
    original does that within the network; sums over all pixels are not exact enough there,
    as onnxruntime has them, and would count what was added to the image to fill it up.)
    Outputs ``keypoints`` (H, W), the probability of a keypoint at each pixel;
    ``reliability`` (H/8, W/8) in [0, 1]; ``descriptors`` (H/8, W/8, 64) of unit length.

    Raises:
        ModelError: the checkpoint is not that of XFeat.
        MissingDependencyError: the package ``onnx`` is not installed.
    """
    graph = GraphWriter()
    skip = graph.add("AveragePool", "image", kernel_shape=[4, 4], strides=[4, 4])
    skip = _convolve(graph, weights, skip, "skip1.1", C(1, 24, kernel=1, plain=True))
    at_4 = _block(graph, weights, "block1", "image")
    at_4 = _block(graph, weights, "block2", graph.add("Add", at_4, skip))
    at_8 = _block(graph, weights, "block3", at_4)
    at_16 = _block(graph, weights, "block4", at_8)
    at_32 = _block(graph, weights, "block5", at_16)
    fused = graph.add("Add", at_8, _enlarge(graph, at_16, 2))
    fused = graph.add("Add", fused, _enlarge(graph, at_32, 4))
    fused = _block(graph, weights, "block_fusion", fused)
    reliability = graph.add("Sigmoid", _block(graph, weights, "heatmap_head", fused))
    cells = graph.add("SpaceToDepth", "image", blocksize=CELL)
    logits = _block(graph, weights, "keypoint_head", cells)
    return graph.finish(
        "xfeat",
        inputs={"image": (1, 1, "height", "width")},
        outputs={
            "keypoints": (_keypoint_map(graph, logits), ("height", "width")),
            "reliability": (
                graph.add("Squeeze", reliability, graph.constant([0, 1], np.int64)),
                ("height_8", "width_8"),
            ),
            "descriptors": (
                _descriptor_map(graph, fused),
                ("height_8", "width_8", DESCRIPTOR_LENGTH),
            ),
        },
        metadata=metadata,
    )


def _block(graph: GraphWriter, weights: Weights, name: str, x: str) -> str:
    for i, layer in enumerate(BLOCKS[name]):
        x = _convolve(graph, weights, x, f"{name}.{i}", layer)
    return x


def _convolve(graph: GraphWriter, weights: Weights, x: str, name: str, layer: Convolution) -> str:
    inputs, outputs, size, stride, plain = layer
    shape = (outputs, inputs, size, size)
    if plain:
        kernel = take(weights, f"{name}.weight", *shape)
        bias = take(weights, f"{name}.bias", outputs)
    else:
        mean = take(weights, f"{name}.layer.1.running_mean", outputs)
        variance = take(weights, f"{name}.layer.1.running_var", outputs)
        factor = 1.0 / np.sqrt(variance + _EPSILON)
        kernel = take(weights, f"{name}.layer.0.weight", *shape) * factor[:, None, None, None]
        bias = -mean * factor
    padded = graph.add(
        "Conv",
        x,
        graph.constant(kernel),
        graph.constant(bias),
        kernel_shape=[size, size],
        strides=[stride, stride],
        pads=[size // 2] * 4,
    )
    return padded if plain else graph.add("Relu", padded)


def _enlarge(graph: GraphWriter, x: str, factor: int) -> str:
    """Bilinear, and the centres of the corner pixels do not stay at the corners."""
    return graph.add(
        "Resize",
        x,
        "",
        graph.constant([1.0, 1.0, factor, factor]),
        mode="linear",
        coordinate_transformation_mode="half_pixel",
    )


def _keypoint_map(graph: GraphWriter, logits: str) -> str:
    """Probabilities of the 64 pixels of each cell, without the 65th: no keypoint."""
    probabilities = graph.add("Softmax", logits, axis=1)
    start, end, axis = (graph.constant([value], np.int64) for value in (0, CELL * CELL, 1))
    pixels = graph.add("Slice", probabilities, start, end, axis)
    pixels = graph.add("DepthToSpace", pixels, blocksize=CELL)
    return graph.add("Squeeze", pixels, graph.constant([0, 1], np.int64))


def _descriptor_map(graph: GraphWriter, features: str) -> str:
    length = graph.add("ReduceL2", features, axes=[1], keepdims=1)
    unit = graph.add("Div", features, graph.add("Max", length, graph.constant(1e-12)))
    last = graph.add("Transpose", unit, perm=[0, 2, 3, 1])
    return graph.add("Squeeze", last, graph.constant([0], np.int64))
