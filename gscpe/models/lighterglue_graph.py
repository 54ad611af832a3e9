# SPDX-License-Identifier: Apache-2.0
"""LighterGlue as an ONNX graph: LightGlue (Lindenberger et al., ICCV 2023) of six layers, one
attention head and 96 channels, trained by the authors of XFeat for its descriptors.

All points stay until the end (the original may drop hopeless ones between layers, for speed).
"""

from __future__ import annotations

from typing import Mapping

import numpy as np
from numpy.typing import NDArray

from gscpe.models.graph import GraphWriter, Weights, take

LAYERS = 6
WIDTH = 96
INPUT_WIDTH = 64
_SIDES = ("a", "b")
_EPSILON = 1e-5


def build_lighterglue(weights: Weights, metadata: Mapping[str, str]) -> bytes:
    """The network as the bytes of an ``.onnx`` file.

    Inputs ``keypoints_a`` (M, 2), ``descriptors_a`` (M, 64), ``keypoints_b`` (N, 2),
    ``descriptors_b`` (N, 64); keypoints are x, y from the middle of the image, in units of
    half its longer side. Output ``log_scores`` (M, N): the logarithm of the probability that
    a pair of points is a match.

    Raises:
        ModelError: the checkpoint is not that of LighterGlue.
        MissingDependencyError: the package ``onnx`` is not installed.
    """
    graph = GraphWriter()
    features = [
        _project(graph, weights, f"descriptors_{side}", "input_proj", INPUT_WIDTH)
        for side in _SIDES
    ]
    angles = [_angles(graph, weights, f"keypoints_{side}") for side in _SIDES]
    for i in range(LAYERS):
        features = [
            _attend_to_self(graph, weights, f"transformers.{i}.self_attn", x, angle)
            for x, angle in zip(features, angles, strict=True)
        ]
        features = _attend_to_other(graph, weights, f"transformers.{i}.cross_attn", *features)
    return graph.finish(
        "lighterglue",
        inputs={
            "keypoints_a": ("points_a", 2),
            "descriptors_a": ("points_a", INPUT_WIDTH),
            "keypoints_b": ("points_b", 2),
            "descriptors_b": ("points_b", INPUT_WIDTH),
        },
        outputs={"log_scores": (_assignment(graph, weights, *features), ("points_a", "points_b"))},
        metadata=metadata,
    )


def _matrix(weights: Weights, name: str, rows: int, columns: int) -> NDArray[np.float64]:
    return take(weights, f"matcher.{name}", rows, columns)


def _vector(weights: Weights, name: str, length: int) -> NDArray[np.float64]:
    return take(weights, f"matcher.{name}", length)


def _project(
    graph: GraphWriter,
    weights: Weights,
    x: str,
    name: str,
    inputs: int = WIDTH,
    outputs: int = WIDTH,
    factor: float = 1.0,
) -> str:
    """A linear layer, times a factor."""
    matrix = _matrix(weights, f"{name}.weight", outputs, inputs)
    return graph.linear(x, factor * matrix, factor * _vector(weights, f"{name}.bias", outputs))


def _angles(graph: GraphWriter, weights: Weights, keypoints: str) -> tuple[str, str]:
    """Cosine and sine, (N, 96), of the angles by which a position turns pairs of channels."""
    per_pair = _matrix(weights, "posenc.Wr.weight", WIDTH // 2, 2)
    angle = graph.linear(keypoints, np.repeat(per_pair, 2, axis=0))
    return graph.add("Cos", angle), graph.add("Sin", angle)


def _attend_to_self(
    graph: GraphWriter, weights: Weights, name: str, x: str, angles: tuple[str, str]
) -> str:
    """Attention within an image. Queries and keys are turned by their positions:
    ``q cos + turned(q) sin``, where the quarter turn is folded into another matrix."""
    weight = _matrix(weights, f"{name}.Wqkv.weight", 3 * WIDTH, WIDTH)
    bias = _vector(weights, f"{name}.Wqkv.bias", 3 * WIDTH)
    rows = np.concatenate([weight, bias[:, None]], axis=1).reshape(WIDTH, 3, WIDTH + 1)
    query, key, value = rows[:, 0] / np.sqrt(WIDTH), rows[:, 1], rows[:, 2]
    stacked = np.concatenate([query, _quarter_turn(query), key, _quarter_turn(key), value])
    parts = graph.add_many("Split", 5, graph.linear(x, stacked[:, :-1], stacked[:, -1]), axis=1)
    turned = [
        graph.add(
            "Add",
            graph.add("Mul", parts[i], angles[0]),
            graph.add("Mul", parts[i + 1], angles[1]),
        )
        for i in (0, 2)
    ]
    similarity = graph.add("MatMul", turned[0], _transpose(graph, turned[1]))
    context = _weighted_mean(graph, similarity, parts[4])
    return _update(graph, weights, name, x, _project(graph, weights, context, f"{name}.out_proj"))


def _attend_to_other(
    graph: GraphWriter, weights: Weights, name: str, x_a: str, x_b: str
) -> list[str]:
    """Attention between the images, in both directions through the same similarities."""
    root = WIDTH**-0.25
    key_a, key_b = (_project(graph, weights, x, f"{name}.to_qk", factor=root) for x in (x_a, x_b))
    value_a, value_b = (_project(graph, weights, x, f"{name}.to_v") for x in (x_a, x_b))
    similarity = graph.add("MatMul", key_a, _transpose(graph, key_b))
    to_a = _weighted_mean(graph, similarity, value_b)
    to_b = _weighted_mean(graph, _transpose(graph, similarity), value_a)
    return [
        _update(graph, weights, name, x, _project(graph, weights, message, f"{name}.to_out"))
        for x, message in ((x_a, to_a), (x_b, to_b))
    ]


def _update(graph: GraphWriter, weights: Weights, name: str, x: str, message: str) -> str:
    """Adds to the features what two layers make of them and the message."""
    both = graph.add("Concat", x, message, axis=1)
    hidden = _project(graph, weights, both, f"{name}.ffn.0", 2 * WIDTH, 2 * WIDTH)
    hidden = graph.add(
        "LayerNormalization",
        hidden,
        graph.constant(_vector(weights, f"{name}.ffn.1.weight", 2 * WIDTH)),
        graph.constant(_vector(weights, f"{name}.ffn.1.bias", 2 * WIDTH)),
        axis=-1,
        epsilon=_EPSILON,
    )
    hidden = _project(graph, weights, _gelu(graph, hidden), f"{name}.ffn.3", 2 * WIDTH)
    return graph.add("Add", x, hidden)


def _assignment(graph: GraphWriter, weights: Weights, x_a: str, x_b: str) -> str:
    """log P(match) = both points have a match at all, and each is the other's."""
    name = f"log_assignment.{LAYERS - 1}"
    root = WIDTH**-0.25
    projected_a, projected_b = (
        _project(graph, weights, x, f"{name}.final_proj", factor=root) for x in (x_a, x_b)
    )
    similarity = graph.add("MatMul", projected_a, _transpose(graph, projected_b))
    has_match_a, has_match_b = (
        _log_sigmoid(graph, _project(graph, weights, x, f"{name}.matchability", outputs=1))
        for x in (x_a, x_b)
    )
    choices = graph.add(
        "Add",
        graph.add("LogSoftmax", similarity, axis=1),
        graph.add("LogSoftmax", similarity, axis=0),
    )
    has_match = graph.add("Add", has_match_a, _transpose(graph, has_match_b))
    return graph.add("Add", choices, has_match)


def _quarter_turn(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """(x, y) to (-y, x) for each pair of rows."""
    pairs = rows.reshape(WIDTH // 2, 2, -1)
    return np.stack([-pairs[:, 1], pairs[:, 0]], axis=1).reshape(rows.shape)


def _transpose(graph: GraphWriter, x: str) -> str:
    return graph.add("Transpose", x, perm=[1, 0])


def _weighted_mean(graph: GraphWriter, similarity: str, values: str) -> str:
    return graph.add("MatMul", graph.add("Softmax", similarity, axis=1), values)


def _gelu(graph: GraphWriter, x: str) -> str:
    """x times the normal distribution function; the operator itself is in opset 20 only."""
    erf = graph.add("Erf", graph.add("Div", x, graph.constant(np.sqrt(2.0))))
    shifted = graph.add("Add", erf, graph.constant(1.0))
    return graph.add("Mul", graph.add("Mul", x, shifted), graph.constant(0.5))


def _log_sigmoid(graph: GraphWriter, x: str) -> str:
    return graph.add("Neg", graph.add("Softplus", graph.add("Neg", x)))
