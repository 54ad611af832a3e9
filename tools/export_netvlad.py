#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes a small NetVLAD as the exported network that ``gscpe build-map --retrieval`` takes.

The network: MobileNetV2 (Sandler et al., CVPR 2018) up to its block 9, and NetVLAD (Arandjelovic
et al., CVPR 2016) with 16 words of 64 numbers. The weights are a Keras file (.h5) of a network
of this form; they are not part of this project, and their licence is theirs. Keras is not needed,
h5py and onnx are (pip install h5py 'gscpe[models]').

Usage: .venv/bin/python tools/export_netvlad.py WEIGHTS.h5 NETVLAD.onnx [--size 640 480]
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gscpe.errors import GscpeError, MissingDependencyError, ModelError
from gscpe.models.graph import GraphWriter, Weights, take

WORDS, LENGTH = 16, 64
"""Of NetVLAD: words, and numbers of each."""

EPSILON = 1e-3
"""Of Keras's batch normalization."""

MEAN, STD = 128 / 255, 0.5
"""The network sees ``(value - 128) * 2 / 255`` of bytes."""


class Block(NamedTuple):
    """An inverted residual: widen (but in the first), filter each channel, narrow; added to what
    came in where the sizes are the same."""

    name: str
    inputs: int
    widened: int
    outputs: int
    stride: int


BLOCKS = (
    Block("expanded_conv", 32, 32, 16, 1),
    Block("block_1", 16, 96, 24, 2),
    Block("block_2", 24, 144, 24, 1),
    Block("block_3", 24, 144, 32, 2),
    Block("block_4", 32, 192, 32, 1),
    Block("block_5", 32, 192, 32, 1),
    Block("block_6", 32, 192, 64, 2),
    *(Block(f"block_{number}", 64, 384, 64, 1) for number in (7, 8, 9)),
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights", type=Path, help="Keras .h5")
    parser.add_argument("output", type=Path, help=".onnx to write; a .json is written beside it")
    parser.add_argument(
        *("--size",), nargs=2, type=int, default=(640, 480), metavar=("W", "H"), help="of its input"
    )
    options = parser.parse_args()
    if options.output.suffix != ".onnx":
        parser.error("the output must be named .onnx")
    try:
        network = build_netvlad(read_keras(options.weights))
    except GscpeError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    options.output.write_bytes(network)
    settings = {"size": list(options.size), "mean": [MEAN] * 3, "std": [STD] * 3}
    options.output.with_suffix(".json").write_text(json.dumps(settings) + "\n")
    print(f"{options.output}: {len(network)} bytes, descriptors of {WORDS * LENGTH} numbers")
    return 0


def read_keras(path: Path) -> Weights:
    """Tensors of a Keras file as ``layer/name``.

    Raises:
        ModelError: it cannot be read.
        MissingDependencyError: h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingDependencyError("reading Keras files needs h5py: pip install h5py") from error
    found: dict[str, NDArray[Any]] = {}

    def keep(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset):
            layer, *_, tensor = name.split("/")
            found[f"{layer}/{tensor.split(':')[0]}"] = np.asarray(node)

    try:
        with h5py.File(path, "r") as file:
            file.get("model_weights", file).visititems(keep)
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {error}") from error
    return found


def build_netvlad(weights: Weights) -> bytes:
    """The network as the bytes of an ``.onnx`` file: ``image`` (1, 3, H, W) to ``descriptor``
    (1, 1024), of unit length.

    Raises:
        ModelError: the weights are not those of such a network.
        MissingDependencyError: the package ``onnx`` is not installed.
    """
    graph = GraphWriter()
    x = _convolve(graph, weights, "image", "Conv1", "bn_Conv1", (3, 3, 3, 32), 2)
    x = _relu6(graph, x)
    for block in BLOCKS:
        x = _block(graph, weights, x, block)
    return graph.finish(
        "netvlad",
        {"image": (1, 3, "height", "width")},
        {"descriptor": (_netvlad(graph, weights, x), (1, WORDS * LENGTH))},
        {"input": "RGB, (value - 128) * 2 / 255"},
    )


def _block(graph: GraphWriter, weights: Weights, x: str, block: Block) -> str:
    start, prefix = x, block.name
    if block.widened != block.inputs:
        shape = (1, 1, block.inputs, block.widened)
        x = _convolve(graph, weights, x, f"{prefix}_expand", f"{prefix}_expand_BN", shape)
        x = _relu6(graph, x)
    name = f"{prefix}_depthwise"
    x = _depthwise(graph, weights, x, name, block.widened, block.stride)
    x = _relu6(graph, x)
    shape = (1, 1, block.widened, block.outputs)
    x = _convolve(graph, weights, x, f"{prefix}_project", f"{prefix}_project_BN", shape)
    return graph.add("Add", start, x) if (block.inputs, block.stride) == (block.outputs, 1) else x


def _convolve(
    graph: GraphWriter,
    weights: Weights,
    x: str,
    name: str,
    norm: str,
    shape: tuple[int, int, int, int],
    stride: int = 1,
) -> str:
    """Kernels are (height, width, inputs, outputs) in Keras."""
    kernel = take(weights, f"{name}/kernel", *shape).transpose(3, 2, 0, 1)
    factor, bias = _normalization(weights, norm, shape[3])
    return _conv(graph, x, kernel * factor[:, None, None, None], bias, stride, groups=1)


def _depthwise(
    graph: GraphWriter, weights: Weights, x: str, name: str, channels: int, stride: int
) -> str:
    kernel = take(weights, f"{name}/depthwise_kernel", 3, 3, channels, 1).transpose(2, 3, 0, 1)
    factor, bias = _normalization(weights, f"{name}_BN", channels)
    return _conv(graph, x, kernel * factor[:, None, None, None], bias, stride, channels)


def _conv(
    graph: GraphWriter,
    x: str,
    kernel: NDArray[np.float64],
    bias: NDArray[np.float64],
    stride: int,
    groups: int,
) -> str:
    # With a stride, Keras's MobileNetV2 adds a row below and a column on the right alone.
    around = [1, 1, 1, 1] if stride == 1 else [0, 0, 1, 1]
    pads = [0, 0, 0, 0] if kernel.shape[2] == 1 else around
    constants = graph.constant(kernel), graph.constant(bias)
    strides = [stride, stride]
    return graph.add("Conv", x, *constants, strides=strides, pads=pads, group=groups)


def _normalization(
    weights: Weights, name: str, channels: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    gamma, beta, mean, variance = (
        take(weights, f"{name}/{part}", channels)
        for part in ("gamma", "beta", "moving_mean", "moving_variance")
    )
    factor = gamma / np.sqrt(variance + EPSILON)
    return factor, beta - mean * factor


def _relu6(graph: GraphWriter, x: str) -> str:
    return graph.add("Clip", x, graph.constant(0.0), graph.constant(6.0))


def _netvlad(graph: GraphWriter, weights: Weights, x: str) -> str:
    """Each pixel's numbers are assigned to all words by a softmax; of each word, the weighted sum
    of ``x + centre`` (the sign is learned) of unit length; all of them of unit length together."""
    layer = "net_vlad_layer_1"
    kernel = take(weights, f"{layer}/kernel", 1, 1, LENGTH, WORDS)[0, 0]
    bias = take(weights, f"{layer}/bias", 1, 1, WORDS)[0, 0]
    centres = take(weights, f"{layer}/cluster_centers", 1, 1, 1, LENGTH, WORDS)[0, 0, 0]
    flat = graph.add("Reshape", x, graph.constant([LENGTH, -1], np.int64))  # (numbers, pixels)
    pixels = graph.add("Transpose", flat, perm=[1, 0])
    logits = graph.add("Add", graph.add("MatMul", pixels, graph.constant(kernel)),
                       graph.constant(bias))  # fmt: skip
    shares = graph.add("Softmax", logits, axis=1)
    by_word = graph.add("Transpose", shares, perm=[1, 0])
    total = graph.add("ReduceSum", by_word, graph.constant([1], np.int64), keepdims=1)
    shifted = graph.add("Mul", total, graph.constant(centres.T))
    words = graph.add("Add", graph.add("MatMul", by_word, pixels), shifted)
    words = _unit(graph, words)
    row = graph.add("Reshape", words, graph.constant([1, WORDS * LENGTH], np.int64))
    return _unit(graph, row)


def _unit(graph: GraphWriter, x: str) -> str:
    length = graph.add("ReduceL2", x, axes=[1], keepdims=1)
    return graph.add("Div", x, graph.add("Max", length, graph.constant(1e-6)))


if __name__ == "__main__":
    sys.exit(main())
