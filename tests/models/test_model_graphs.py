# SPDX-License-Identifier: Apache-2.0
"""The ONNX graphs against slow evaluations written from the definitions, in double precision."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from networks import Arrays, random_lighterglue, random_xfeat
from numpy.typing import NDArray
from scipy.special import expit, log_expit, log_softmax, ndtr, softmax

from gscpe.errors import ModelError
from gscpe.models.lighterglue_graph import LAYERS, build_lighterglue
from gscpe.models.xfeat_graph import BLOCKS, build_xfeat

pytest.importorskip("onnx", reason="onnx is an optional package (extra: models)")
onnxruntime = pytest.importorskip("onnxruntime", reason="onnxruntime has no wheel here")

Array = NDArray[np.float64]


def run(model: bytes, **inputs: NDArray[Any]) -> list[NDArray[Any]]:
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    return list(session.run(None, {name: x.astype(np.float32) for name, x in inputs.items()}))


def convolve(x: Array, kernel: Array, stride: int) -> Array:
    margin = kernel.shape[2] // 2
    padded = np.pad(x, ((0, 0), (margin, margin), (margin, margin)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, kernel.shape[2:], axis=(1, 2))
    return np.asarray(np.einsum("ihwkl,oikl->ohw", windows[:, ::stride, ::stride], kernel))


def block(weights: Arrays, name: str, x: Array) -> Array:
    for i, layer in enumerate(BLOCKS[name]):
        prefix = f"{name}.{i}"
        if layer.plain:
            bias = weights[f"{prefix}.bias"][:, None, None]
            x = convolve(x, weights[f"{prefix}.weight"].astype(np.float64), 1) + bias
        else:
            x = convolve(x, weights[f"{prefix}.layer.0.weight"].astype(np.float64), layer.stride)
            mean, variance = (
                weights[f"{prefix}.layer.1.running_{part}"].astype(np.float64)[:, None, None]
                for part in ("mean", "var")
            )
            x = np.maximum((x - mean) / np.sqrt(variance + 1e-5), 0.0)
    return x


def enlarge(x: Array, factor: int) -> Array:
    for axis in (1, 2):
        length = x.shape[axis]
        places = (np.arange(length * factor) + 0.5) / factor - 0.5
        x = np.apply_along_axis(
            lambda line, at=places, n=length: np.interp(at, np.arange(n), line), axis, x
        )
    return x


def xfeat(weights: Arrays, image: Array) -> tuple[Array, Array, Array]:
    height, width = image.shape
    x = image[None]
    blocks = image.reshape(height // 4, 4, width // 4, 4).mean(axis=(1, 3))
    skip = weights["skip1.1.weight"][:, 0] * blocks + weights["skip1.1.bias"][:, None, None]
    at_4 = block(weights, "block2", block(weights, "block1", x) + skip)
    at_8 = block(weights, "block3", at_4)
    at_16 = block(weights, "block4", at_8)
    at_32 = block(weights, "block5", at_16)
    features = block(weights, "block_fusion", at_8 + enlarge(at_16, 2) + enlarge(at_32, 4))
    reliability = expit(block(weights, "heatmap_head", features))[0]
    cells = np.stack([image[v::8, u::8] for v in range(8) for u in range(8)])
    chances = softmax(block(weights, "keypoint_head", cells), axis=0)
    keypoints = np.zeros((height, width))
    for i in range(64):
        keypoints[i // 8 :: 8, i % 8 :: 8] = chances[i]
    return keypoints, reliability, (features / np.linalg.norm(features, axis=0)).transpose(1, 2, 0)


def test_xfeat(rng: np.random.Generator) -> None:
    weights, image = random_xfeat(rng), rng.normal(size=(64, 96))
    found = run(build_xfeat(weights, {}), image=image[None, None])
    for output, expected in zip(found, xfeat(weights, image), strict=True):
        assert output.shape == expected.shape
        np.testing.assert_allclose(output, expected, atol=2e-5)
        assert np.ptp(expected) > 0.1  # neither constant nor saturated


def linear(weights: Arrays, name: str, x: Array) -> Array:
    return x @ weights[f"matcher.{name}.weight"].T.astype(np.float64) + weights[
        f"matcher.{name}.bias"
    ].astype(np.float64)


def update(weights: Arrays, name: str, x: Array, message: Array) -> Array:
    y = linear(weights, f"{name}.ffn.0", np.concatenate([x, message], axis=1))
    y = (y - y.mean(axis=1, keepdims=True)) / np.sqrt(y.var(axis=1, keepdims=True) + 1e-5)
    y = y * weights[f"matcher.{name}.ffn.1.weight"] + weights[f"matcher.{name}.ffn.1.bias"]
    return x + linear(weights, f"{name}.ffn.3", y * ndtr(y))


def attend(query: Array, key: Array, value: Array) -> Array:
    return np.asarray(softmax(query @ key.T / np.sqrt(96), axis=1) @ value)


def turn(x: Array, angles: Array) -> Array:
    turned = (x[:, 0::2] + 1j * x[:, 1::2]) * np.exp(1j * angles)
    return np.stack([turned.real, turned.imag], axis=2).reshape(x.shape)


def lighterglue(weights: Arrays, *inputs: Array) -> Array:
    angles = [inputs[i] @ weights["matcher.posenc.Wr.weight"].T for i in (0, 2)]
    a, b = (linear(weights, "input_proj", inputs[i]) for i in (1, 3))
    for i in range(LAYERS):
        name = f"transformers.{i}.self_attn"
        both = []
        for x, angle in ((a, angles[0]), (b, angles[1])):
            query, key, value = linear(weights, f"{name}.Wqkv", x).reshape(-1, 96, 3).T
            context = attend(turn(query.T, angle), turn(key.T, angle), value.T)
            both.append(update(weights, name, x, linear(weights, f"{name}.out_proj", context)))
        a, b = both
        name = f"transformers.{i}.cross_attn"
        key_a, key_b = (linear(weights, f"{name}.to_qk", x) for x in (a, b))
        value_a, value_b = (linear(weights, f"{name}.to_v", x) for x in (a, b))
        to_a, to_b = attend(key_a, key_b, value_b), attend(key_b, key_a, value_a)
        a, b = (
            update(weights, name, x, linear(weights, f"{name}.to_out", message))
            for x, message in ((a, to_a), (b, to_b))
        )
    name = f"log_assignment.{LAYERS - 1}"
    last_a, last_b = (linear(weights, f"{name}.final_proj", x) for x in (a, b))
    similarity = last_a @ last_b.T / np.sqrt(96)
    match_a, match_b = (log_expit(linear(weights, f"{name}.matchability", x)) for x in (a, b))
    choices = log_softmax(similarity, axis=0) + log_softmax(similarity, axis=1)
    return np.asarray(choices + match_a + match_b.T)


def test_lighterglue(rng: np.random.Generator) -> None:
    weights = random_lighterglue(rng)
    inputs = [
        array
        for count in (7, 5)
        for array in (rng.uniform(-1, 1, size=(count, 2)), rng.normal(size=(count, 64)))
    ]
    names = ("keypoints_a", "descriptors_a", "keypoints_b", "descriptors_b")
    (found,) = run(build_lighterglue(weights, {}), **dict(zip(names, inputs, strict=True)))
    expected = lighterglue(weights, *inputs)
    assert found.shape == (7, 5)
    np.testing.assert_allclose(found, expected, atol=2e-4)
    assert np.ptp(expected) > 1.0


@pytest.mark.parametrize("change", ["missing", "another shape", "not finite"])
def test_checkpoints_of_another_network(change: str, rng: np.random.Generator) -> None:
    weights = random_xfeat(rng)
    name = "block3.1.layer.0.weight"
    if change == "missing":
        del weights[name]
    elif change == "another shape":
        weights[name] = weights[name][:, :-1]
    else:
        weights[name][0, 0, 0, 0] = np.nan
    with pytest.raises(ModelError, match=r"block3\.1\.layer\.0\.weight"):
        build_xfeat(weights, {})
    with pytest.raises(ModelError, match="another network"):
        build_lighterglue(random_xfeat(rng), {})
