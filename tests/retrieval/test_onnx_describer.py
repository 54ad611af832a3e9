# SPDX-License-Identifier: Apache-2.0
"""Exported global descriptors: what goes in, what comes out, and damage that is noticed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import some_map
from scenes import room_camera

from gscpe.errors import MapError, ModelError, SettingsError
from gscpe.photos import Photo
from gscpe.retrieval import OnnxDescriber, describe_references, open_describer
from gscpe.scene import GlobalDescriptors, open_map, save_map

onnx = pytest.importorskip("onnx", reason="onnx is an optional package (extra: models)")
pytest.importorskip("onnxruntime", reason="onnxruntime has no wheel here")

INPUT = {"size": [8, 6], "mean": [0.5, 0.4, 0.3], "std": [0.2, 0.3, 0.4]}
RNG = np.random.default_rng(5)
WEIGHTS = RNG.normal(size=(3 * 6 * 8, 10)).astype(np.float32)
IMAGE = RNG.integers(0, 256, size=(6, 8, 3), dtype=np.uint8)


def write_network(path: Path, weights: Any = WEIGHTS, **changes: Any) -> Path:
    """A network that multiplies the flattened image with weights, and its .json."""
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    name = changes.get("input", "image")
    shape, output = changes.get("shape", [1, 3, 6, 8]), changes.get("output", [1, "d"])
    nodes = [
        helper.make_node("Flatten", [name], ["flat"], axis=1),
        helper.make_node("MatMul", ["flat", "weights"], ["product"]),
        helper.make_node(changes.get("last", "Identity"), ["product"], ["descriptor"]),
    ]
    graph = helper.make_graph(
        nodes,
        "descriptor",
        [helper.make_tensor_value_info(name, kind, shape)],
        [helper.make_tensor_value_info("descriptor", kind, output)],
        [onnx.numpy_helper.from_array(weights, "weights")],
    )
    opsets = [helper.make_opsetid("", changes.get("opset", 17))]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=8)
    path.write_bytes(model.SerializeToString())
    path.with_suffix(".json").write_text(json.dumps(INPUT | changes.get("settings", {})))
    return path


@pytest.fixture
def network(tmp_path: Path) -> Path:
    return write_network(tmp_path / "net.onnx")


def with_(name: str, value: Any) -> str:
    return json.dumps(INPUT | {name: value})


def expected(image: Any, weights: Any = WEIGHTS) -> Any:
    values = (image / 255 - INPUT["mean"]) / INPUT["std"]
    product = values.transpose(2, 0, 1).ravel() @ weights
    return product / np.linalg.norm(product)


def photo(rgb: Any) -> Photo:
    return Photo(rgb, room_camera(rgb.shape[1], rgb.shape[0]))


@pytest.mark.parametrize("shape", [[1, 3, 6, 8], ["n", 3, "h", "w"]])
def test_the_documented_input_and_output(shape: Any, tmp_path: Path) -> None:
    path = write_network(tmp_path / "net.onnx", shape=shape, output=["n", 10])
    descriptor = OnnxDescriber(path, threads=1).describe(IMAGE)
    assert descriptor.dtype == np.float32
    assert np.linalg.norm(descriptor) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(descriptor, expected(IMAGE), atol=1e-5)


def test_images_of_other_sizes(tmp_path: Path) -> None:
    """Twice the pixels stretch to the same; wider images are cropped to their middle."""
    stretch = OnnxDescriber(write_network(tmp_path / "a.onnx"))
    crop = OnnxDescriber(write_network(tmp_path / "b.onnx", settings={"resize": "crop"}))
    twice = IMAGE.repeat(2, axis=0).repeat(2, axis=1)
    for describer in (stretch, crop):
        np.testing.assert_allclose(describer.describe(twice), expected(IMAGE), atol=1e-5)
    wide = np.pad(IMAGE, ((0, 0), (5, 5), (0, 0)))
    np.testing.assert_allclose(crop.describe(wide), expected(IMAGE), atol=1e-5)
    tall = np.pad(IMAGE, ((7, 7), (0, 0), (0, 0)))
    np.testing.assert_allclose(crop.describe(tall), expected(IMAGE), atol=1e-5)
    assert np.abs(stretch.describe(wide) - expected(IMAGE)).max() > 0.05
    for shape in ((1, 1, 3), (1, 4000, 3), (900, 2, 3)):
        for describer in (stretch, crop):
            assert np.isfinite(describer.describe(np.zeros(shape, np.uint8))).all()


def test_nothing_to_describe_is_all_zero(tmp_path: Path) -> None:
    path = write_network(tmp_path / "net.onnx", np.zeros_like(WEIGHTS))
    np.testing.assert_array_equal(OnnxDescriber(path).describe(IMAGE), np.zeros(10))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"input": "x"}, 'must have one input, "image"; it has: x'),
        ({"shape": [1, 3, 8, 6]}, r"does not take the tensor\(float\) of shape \(1, 3, 6, 8\)"),
        ({"shape": [1, 144]}, "does not take"),
        (
            {"output": ["d", 1], "last": "Transpose"},
            r"descriptor, is a .* of shape \[10, 1\] instead",
        ),
        ({"opset": 99}, "needs a newer onnxruntime"),
    ],
)
def test_another_network(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = write_network(tmp_path / "net.onnx", **changes)
    with pytest.raises(ModelError, match=message) as caught:
        OnnxDescriber(path)
    assert "net.onnx" in str(caught.value)


def test_outputs_that_are_no_descriptor(tmp_path: Path) -> None:
    path = write_network(tmp_path / "log.onnx", -np.abs(WEIGHTS), last="Log")
    with pytest.raises(ModelError, match=r"log\.onnx: output descriptor holds values that are not"):
        OnnxDescriber(path).describe(np.full((6, 8, 3), 255, np.uint8))
    settings = {"size": [8, 12]}
    path = write_network(tmp_path / "two.onnx", shape=["n", 3, "h", "w"], settings=settings)
    with pytest.raises(ModelError, match=r"two\.onnx cannot be run"):
        OnnxDescriber(path).describe(IMAGE)


@pytest.mark.parametrize("output", [np.zeros((1, 4, 1)), np.zeros(4), np.zeros((2, 4)), [], None])
def test_shapes_that_the_file_does_not_tell(output: Any, network: Path) -> None:
    describer = OnnxDescriber(network)
    describer._session = SimpleNamespace(run=lambda *_: [output])
    with pytest.raises(ModelError, match=r"net\.onnx: output descriptor is .* instead of \(1, D\)"):
        describer.describe(IMAGE)


@pytest.mark.parametrize(
    "text",
    [
        *("", "null", "[]", "3", "{", "{}", '"size"', "[" * 100_000),
        *(json.dumps(INPUT | {"size": size}) for size in (None, 8, [8], [8, 6, 3], [8, 0])),
        *(with_("size", size) for size in (None, 8, [8], [8, 6, 3], [8, 0], [8.0, 6])),
        *(with_("size", size) for size in (["8", "6"], [True, 6], [9e9, 6])),
        *(with_("mean", mean) for mean in (0.5, [1, 2], ["a", 1, 2], [None] * 3)),
        *(with_("std", std) for std in ([1, 1, 0], [1, 1, -1], [1, 1, float("nan")])),
        *(with_("resize", resize) for resize in ("pad", None, ["crop"])),
        json.dumps(INPUT | {"sise": [8, 6]}),
        json.dumps({"size": [8, 6], "mean": [0, 0, 0]}),
    ],
)
def test_damaged_settings(text: str, network: Path) -> None:
    network.with_suffix(".json").write_text(text)
    with pytest.raises(ModelError, match=r"net\.json"):
        OnnxDescriber(network)


def test_missing_and_damaged_files(network: Path) -> None:
    whole = network.read_bytes()
    for data in (b"", b"hello", whole[: len(whole) // 2]):
        network.write_bytes(data)
        with pytest.raises(ModelError, match=r"net\.onnx"):
            OnnxDescriber(network)
    network.unlink()
    with pytest.raises(ModelError, match=r"net\.onnx is missing; .*global descriptor"):
        OnnxDescriber(network)
    network.write_bytes(whole)
    network.with_suffix(".json").unlink()
    with pytest.raises(ModelError, match=r"net\.json is missing; .*size, mean, std"):
        OnnxDescriber(network)


@pytest.fixture
def known(network: Path) -> GlobalDescriptors:
    other = RNG.integers(0, 256, size=(30, 40, 3), dtype=np.uint8)
    return describe_references([photo(IMAGE), photo(other)], f"onnx:{network}")


def test_queries_are_described_as_references(known: GlobalDescriptors, network: Path) -> None:
    assert known.method == "onnx"
    assert known.model is not None
    assert known.model.file == "net.onnx"
    descriptor = open_describer(known, network).describe(IMAGE)
    np.testing.assert_array_equal(descriptor, known.descriptors[0])


@pytest.mark.parametrize("compress", [False, True])
def test_the_map_remembers_the_network(
    compress: bool, known: GlobalDescriptors, network: Path, tmp_path: Path
) -> None:
    if compress:
        pytest.importorskip("gaussforge", reason="gaussforge is an optional package")
    map_ = replace(some_map(np.random.default_rng(2), references=2), descriptors=known)
    save_map(map_, tmp_path / "m", compress=compress)
    network.unlink()
    opened = open_map(tmp_path / "m").descriptors  # without the network
    assert (opened.method, opened.model) == (known.method, known.model)
    assert opened.vocabulary.shape == (0, 0)
    np.testing.assert_allclose(opened.descriptors, known.descriptors, atol=1e-3)
    with pytest.raises(ModelError, match=r"net\.onnx .*missing; put the file and its \.json"):
        open_describer(opened)


def test_networks_are_found_in_the_model_folder(
    known: GlobalDescriptors, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path / "models"))
    (tmp_path / "models" / "descriptors").mkdir(parents=True)
    write_network(tmp_path / "models" / "descriptors" / "net.onnx")
    descriptor = open_describer(known).describe(IMAGE)
    np.testing.assert_array_equal(descriptor, known.descriptors[0])


def test_another_network_than_the_maps(known: GlobalDescriptors, network: Path) -> None:
    assert known.model is not None
    write_network(network, WEIGHTS + 1)
    with pytest.raises(ModelError, match="is not the network") as caught:
        open_describer(known, network)
    assert known.model.sha256 in str(caught.value)
    write_network(network, settings={"std": [0.2, 0.3, 0.5]})
    with pytest.raises(ModelError, match=r"net\.json differs from the one"):
        open_describer(known, network)
    write_network(network)
    network.with_name("net.onnx.data").write_bytes(b"other weights")
    with pytest.raises(ModelError, match="is not the network"):
        open_describer(known, network)
    with pytest.raises(MapError, match="does not say which network"):
        open_describer(replace(known, model=None), network)


@pytest.mark.parametrize("method", ["onnx", "onnx:", "vlad:x", "netvlad", ""])
def test_unknown_methods(method: str) -> None:
    with pytest.raises(SettingsError, match="the methods are vlad, vlad-xfeat, onnx:PATH"):
        describe_references([photo(IMAGE)], method)
