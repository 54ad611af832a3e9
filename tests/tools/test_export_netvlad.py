# SPDX-License-Identifier: Apache-2.0
"""tools/export_netvlad.py: its ONNX computes what the layers' definitions say."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from gscpe.errors import ModelError

pytest.importorskip("onnx")
Array = NDArray[np.float64]


@pytest.fixture
def netvlad(tool: Callable[[str], Any]) -> Any:
    return tool("export_netvlad")


def random_weights(tool: Any, rng: np.random.Generator) -> dict[str, Array]:
    weights: dict[str, Array] = {}

    def norm(name: str, channels: int) -> None:
        weights[f"{name}/gamma"] = rng.uniform(0.5, 1.5, channels)
        weights[f"{name}/beta"] = rng.normal(0.3, 0.5, channels)
        weights[f"{name}/moving_mean"] = rng.normal(0, 0.3, channels)
        weights[f"{name}/moving_variance"] = rng.uniform(0.2, 2.0, channels)

    def convolution(name: str, bn: str, *shape: int) -> None:
        scale = 1.0 / np.sqrt(shape[0] * shape[1] * shape[2])
        weights[f"{name}/kernel"] = rng.normal(0, scale, shape)
        norm(bn, shape[3])

    convolution("Conv1", "bn_Conv1", 3, 3, 3, 32)
    for b in tool.BLOCKS:
        if b.widened != b.inputs:
            convolution(f"{b.name}_expand", f"{b.name}_expand_BN", 1, 1, b.inputs, b.widened)
        weights[f"{b.name}_depthwise/depthwise_kernel"] = rng.normal(0, 0.4, (3, 3, b.widened, 1))
        norm(f"{b.name}_depthwise_BN", b.widened)
        convolution(f"{b.name}_project", f"{b.name}_project_BN", 1, 1, b.widened, b.outputs)
    weights["net_vlad_layer_1/kernel"] = rng.normal(0, 0.02, (1, 1, 64, 16))
    weights["net_vlad_layer_1/bias"] = rng.normal(0, 0.3, (1, 1, 16))
    weights["net_vlad_layer_1/cluster_centers"] = rng.normal(0, 0.5, (1, 1, 1, 64, 16))
    return weights


def forward(tool: Any, weights: dict[str, Array], image: Array) -> Array:
    """The network of an (H, W, 3) image as Keras defines its layers, channels last."""

    def norm(x: Array, name: str) -> Array:
        w = {part: weights[f"{name}/{part}"] for part in ("gamma", "beta")}
        mean, variance = weights[f"{name}/moving_mean"], weights[f"{name}/moving_variance"]
        return np.asarray((x - mean) / np.sqrt(variance + 1e-3) * w["gamma"] + w["beta"])

    def windows(x: Array, stride: int) -> Array:
        before = 1 if stride == 1 else 0
        padded = np.pad(x, ((before, 1), (before, 1), (0, 0)))
        view = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(0, 1))
        return np.asarray(view[::stride, ::stride])  # (H, W, C, 3, 3)

    x = np.einsum("hwcij,ijco->hwo", windows(image, 2), weights["Conv1/kernel"])
    x = np.clip(norm(x, "bn_Conv1"), 0, 6)
    for b in tool.BLOCKS:
        start = x
        if b.name != "expanded_conv":
            x = np.clip(
                norm(x @ weights[f"{b.name}_expand/kernel"][0, 0], f"{b.name}_expand_BN"), 0, 6
            )
        kernel = weights[f"{b.name}_depthwise/depthwise_kernel"][..., 0]
        x = np.einsum("hwcij,ijc->hwc", windows(x, b.stride), kernel)
        x = np.clip(norm(x, f"{b.name}_depthwise_BN"), 0, 6)
        x = norm(x @ weights[f"{b.name}_project/kernel"][0, 0], f"{b.name}_project_BN")
        if b.name in {f"block_{number}" for number in (2, 4, 5, 7, 8, 9)}:
            x = start + x
    pixels = x.reshape(-1, 64)
    layer = "net_vlad_layer_1"
    logits = pixels @ weights[f"{layer}/kernel"][0, 0] + weights[f"{layer}/bias"][0, 0]
    shares = np.exp(logits - logits.max(axis=1, keepdims=True))
    shares /= shares.sum(axis=1, keepdims=True)
    centres = weights[f"{layer}/cluster_centers"][0, 0, 0].T
    words = np.einsum("nk,nkd->kd", shares, pixels[:, None] + centres)
    words /= np.maximum(np.linalg.norm(words, axis=1, keepdims=True), 1e-6)  # as l2_normalize
    return np.asarray(words.ravel() / np.linalg.norm(words))


def test_onnx_computes_what_keras_defines(
    netvlad: Any, rng: np.random.Generator, tmp_path: Path
) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    weights = random_weights(netvlad, rng)
    session = onnxruntime.InferenceSession(
        netvlad.build_netvlad(weights), providers=["CPUExecutionProvider"]
    )
    image = rng.uniform(-1, 1, (48, 64, 3))
    tensor = image.transpose(2, 0, 1)[None].astype(np.float32)
    (found,) = session.run(None, {"image": tensor})
    assert found.shape == (1, 1024)
    assert np.abs(found[0] - forward(netvlad, weights, image)).max() < 2e-5


def test_other_weights_are_refused(netvlad: Any, rng: np.random.Generator, tmp_path: Path) -> None:
    weights = random_weights(netvlad, rng)
    with pytest.raises(ModelError, match="block_9_project"):
        netvlad.build_netvlad({k: v for k, v in weights.items() if "block_9_project/" not in k})
    weights["Conv1/kernel"] = weights["Conv1/kernel"][:, :, :, :16]
    with pytest.raises(ModelError, match="shape"):
        netvlad.build_netvlad(weights)


def test_a_keras_file_becomes_a_describer(
    netvlad: Any, rng: np.random.Generator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py = pytest.importorskip("h5py")
    pytest.importorskip("onnxruntime")
    from gscpe.retrieval import OnnxDescriber

    with h5py.File(tmp_path / "weights.h5", "w") as file:
        for name, values in random_weights(netvlad, rng).items():
            layer, tensor = name.split("/")
            file[f"model_weights/{layer}/{layer}/{tensor}:0"] = values.astype(np.float32)
    output = tmp_path / "netvlad.onnx"
    arguments = [str(tmp_path / "weights.h5"), str(output), "--size", "64", "48"]
    monkeypatch.setattr("sys.argv", ["export_netvlad.py", *arguments])
    assert netvlad.main() == 0
    photo = rng.integers(0, 256, (96, 128, 3), dtype=np.uint8)
    descriptor = OnnxDescriber(output).describe(photo)
    assert descriptor.shape == (1024,)
    assert np.linalg.norm(descriptor) == pytest.approx(1.0, abs=1e-5)
    (tmp_path / "weights.h5").write_bytes(b"nothing")
    assert netvlad.main() == 2
