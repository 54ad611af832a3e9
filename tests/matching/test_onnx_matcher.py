# SPDX-License-Identifier: Apache-2.0
"""Matchers in ONNX files, on small real ones whose answers are known."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from gscpe.errors import MissingDependencyError, ModelError, SettingsError
from gscpe.matching import Matches, OnnxMatcher, OnnxMatcherSettings, PolishSettings, make_matcher

onnx = pytest.importorskip("onnx", reason="onnx is an optional package (extra: models)")
pytest.importorskip("onnxruntime", reason="onnxruntime has no wheel here")

PLAIN = OnnxMatcherSettings(polish=None)
HALF = OnnxMatcherSettings(top_left_pixel_centre=0.5, polish=None)
Shape = Sequence[int | str | None]


def write(
    path: Path,
    nodes: Sequence[Any],
    *,
    image: Shape = (1, 1, "H", "W"),
    inputs: Sequence[str] = ("image0", "image1"),
    outputs: Sequence[tuple[str, Shape]] = (
        ("points0", ("N", 2)),
        ("points1", ("N", 2)),
        ("scores", ("N",)),
    ),
    kind: int = onnx.TensorProto.FLOAT,
    opset: int = 17,
) -> Path:
    helper = onnx.helper
    graph = helper.make_graph(
        list(nodes),
        "matcher",
        [helper.make_tensor_value_info(n, onnx.TensorProto.FLOAT, list(image)) for n in inputs],
        [helper.make_tensor_value_info(n, kind, list(shape)) for n, shape in outputs],
    )
    opsets = [helper.make_opsetid("", opset)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path


def constant(name: str, value: Any, dtype: Any = np.float32) -> Any:
    tensor = onnx.numpy_helper.from_array(np.asarray(value, dtype=dtype))
    return onnx.helper.make_node("Constant", [], [name], value=tensor)


def fixed_answer(path: Path, points0: Any, points1: Any, scores: Any, **more: Any) -> Path:
    """A matcher that always gives the same."""
    nodes = [constant("points0", points0), constant("points1", points1), constant("scores", scores)]
    return write(path, nodes, **more)


def brightest_pixel(path: Path, image: Shape = (1, 1, "H", "W"), centre: float = 0.0) -> Path:
    """A matcher of the brightest pixel of the last channel; its brightness is the score."""
    node = onnx.helper.make_node
    nodes = [
        constant("last", [image[1] - 1], np.int64),  # type: ignore[operator]
        constant("channel", [1], np.int64),
        constant("three", [3], np.int64),
        constant("four", [4], np.int64),
        constant("flat", [-1], np.int64),
        constant("pair", [1, 2], np.int64),
        constant("centre", centre),
        constant("end", [2**31], np.int64),
    ]
    for i in ("0", "1"):
        nodes += [
            node("Slice", [f"image{i}", "last", "end", "channel"], [f"grey{i}"]),
            node("Shape", [f"grey{i}"], [f"shape{i}"]),
            node("Slice", [f"shape{i}", "three", "four"], [f"width{i}"]),
            node("Reshape", [f"grey{i}", "flat"], [f"values{i}"]),
            node("ArgMax", [f"values{i}"], [f"index{i}"], axis=0, keepdims=1),
            node("Mod", [f"index{i}", f"width{i}"], [f"x{i}"]),
            node("Div", [f"index{i}", f"width{i}"], [f"y{i}"]),
            node("Concat", [f"x{i}", f"y{i}"], [f"xy{i}"], axis=0),
            node("Reshape", [f"xy{i}", "pair"], [f"row{i}"]),
            node("Cast", [f"row{i}"], [f"whole{i}"], to=onnx.TensorProto.FLOAT),
            node("Add", [f"whole{i}", "centre"], [f"points{i}"]),
        ]
    nodes.append(node("ReduceMax", ["values0"], ["scores"], axes=[0], keepdims=1))
    return write(path, nodes, image=image)


def dot(x: int, y: int, width: int = 60, height: int = 40, size: int = 1) -> NDArray[np.uint8]:
    """A grey image with a white square whose top-left pixel is (x, y)."""
    image = np.full((height, width, 3), 20, np.uint8)
    image[y : y + size, x : x + size] = 255
    return image


def match(
    path: Path,
    a: NDArray[np.uint8],
    b: NDArray[np.uint8],
    settings: OnnxMatcherSettings | None = PLAIN,
) -> Matches:
    matcher = OnnxMatcher(path, settings, threads=1)
    return matcher.match(matcher.prepare(a, None), matcher.prepare(b, None))


GRID = np.stack(np.meshgrid(np.arange(5.0, 50, 9), np.arange(5.0, 30, 8)), axis=-1).reshape(-1, 2)
SHIFT = np.array([2.25, -1.5])


@pytest.mark.parametrize(("settings", "offset"), [(PLAIN, 0.5), (HALF, 0.0)])
def test_a_grid_and_its_shifted_copy(
    settings: OnnxMatcherSettings, offset: float, tmp_path: Path
) -> None:
    scores = np.linspace(0, 1, len(GRID))
    path = fixed_answer(tmp_path / "grid.onnx", GRID, GRID + SHIFT, scores)
    matches = match(path, dot(1, 1), dot(2, 2), settings)
    np.testing.assert_allclose(matches.photo_pixels, GRID + offset)
    np.testing.assert_allclose(matches.render_pixels, GRID + SHIFT + offset)
    np.testing.assert_allclose(matches.scores, scores, rtol=1e-6)
    assert matches.photo_pixels.dtype == matches.render_pixels.dtype == np.float64
    assert matches.scores.dtype == np.float32


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("settings", [PLAIN, HALF])
def test_the_brightest_pixel(channels: int, settings: OnnxMatcherSettings, tmp_path: Path) -> None:
    path = brightest_pixel(
        tmp_path / "dot.onnx", (1, channels, "H", "W"), settings.top_left_pixel_centre
    )
    matches = match(path, dot(17, 31), dot(50, 4), settings)
    np.testing.assert_array_equal(matches.photo_pixels, [[17.5, 31.5]])
    np.testing.assert_array_equal(matches.render_pixels, [[50.5, 4.5]])
    np.testing.assert_array_equal(matches.scores, [1.0])


def test_channels_are_red_green_blue(tmp_path: Path) -> None:
    path = brightest_pixel(tmp_path / "blue.onnx", (1, 3, "H", "W"))
    image = np.zeros((40, 60, 3), np.uint8)
    image[10, 20, 0], image[30, 40, 2] = 255, 200
    matches = match(path, image, image)
    np.testing.assert_array_equal(matches.photo_pixels, [[40.5, 30.5]])
    np.testing.assert_allclose(matches.scores, [200 / 255], rtol=1e-6)


@pytest.mark.parametrize(
    ("size", "factor"), [((40, 60), 1), ((20, 30), 2), ((80, 120), 0.5), ((20, 60), (1, 2))]
)
def test_fixed_sizes(size: tuple[int, int], factor: Any, tmp_path: Path) -> None:
    """A square of 4 pixels is found at the centre of the pixel that it becomes."""
    path = brightest_pixel(tmp_path / "fixed.onnx", (1, 1, *size))
    matches = match(path, dot(16, 24, size=4), dot(40, 8, size=4))
    found = np.array([[matches.photo_pixels[0], matches.render_pixels[0]]]) / factor
    assert np.all(np.abs(found % 1 - 0.5) < 1e-9)  # centres of pixels of the resized image
    first = np.stack([matches.photo_pixels[0] - (16, 24), matches.render_pixels[0] - (40, 8)])
    np.testing.assert_allclose(first, np.broadcast_to(np.multiply(0.5, factor), (2, 2)), atol=0.75)


def test_points_are_scaled_back_with_pixel_centres(tmp_path: Path) -> None:
    """Half the width and a quarter of the height: the corner of the image stays in place."""
    points = [[0.0, 0.0], [29.0, 9.0]]
    path = fixed_answer(tmp_path / "m.onnx", points, points, [1, 1], image=(1, 3, 10, 30))
    matches = match(path, dot(1, 1), dot(1, 1))
    np.testing.assert_allclose(matches.photo_pixels, [[1.0, 2.0], [59.0, 38.0]])
    large = match(path, dot(1, 1, 120, 80), dot(1, 1))
    np.testing.assert_allclose(large.photo_pixels, [[2.0, 4.0], [118.0, 76.0]])
    np.testing.assert_allclose(large.render_pixels, matches.render_pixels)


def test_sizes_that_must_be_multiples(tmp_path: Path) -> None:
    """Images are continued, not scaled; what is found there is dropped."""
    path = fixed_answer(tmp_path / "m.onnx", [[5, 5], [63, 63], [59.6, 39]], [[6, 6]] * 3, [1] * 3)
    matcher = OnnxMatcher(path, OnnxMatcherSettings(multiple_of=32, polish=None))
    image = matcher.prepare(dot(3, 3), None)
    assert image.tensor.shape == (1, 1, 64, 64)
    assert np.all(image.tensor[0, 0, 40:, :60] == image.tensor[0, 0, 39, :60])
    matches = matcher.match(image, image)
    np.testing.assert_array_equal(matches.photo_pixels, [[5.5, 5.5]])


def test_invalid_places_are_left_out(tmp_path: Path) -> None:
    scores = np.arange(len(GRID))
    matcher = OnnxMatcher(fixed_answer(tmp_path / "m.onnx", GRID, GRID, scores), PLAIN)
    left, upper = np.zeros((2, 40, 60), dtype=bool)
    left[:, :24], upper[:22] = True, True
    image = dot(1, 1)
    matches = matcher.match(matcher.prepare(image, left), matcher.prepare(image, upper))
    expected = (GRID[:, 0] < 24) & (GRID[:, 1] < 22)
    assert 0 < expected.sum() < len(GRID)
    np.testing.assert_array_equal(matches.photo_pixels, GRID[expected] + 0.5)
    np.testing.assert_array_equal(matches.scores, scores[expected])
    nowhere = matcher.prepare(image, np.zeros_like(left))
    assert len(matcher.match(nowhere, nowhere)) == 0


def test_no_matches(tmp_path: Path) -> None:
    none = np.zeros((0, 2))
    for settings in (PLAIN, OnnxMatcherSettings()):
        path = fixed_answer(tmp_path / "none.onnx", none, none, np.zeros(0))
        matches = match(path, dot(1, 1), dot(1, 1), settings)
        assert len(matches) == 0
        assert matches.photo_pixels.shape == matches.render_pixels.shape == (0, 2)


def test_matches_are_polished(tmp_path: Path, rng: np.random.Generator) -> None:
    """A texture that is shifted by (1, 2), and matches that do not know it."""
    texture = rng.integers(0, 256, (10, 15, 3), dtype=np.uint8)
    image = np.kron(texture, np.ones((4, 4, 1), np.uint8))
    moved = np.roll(image, (2, 1), axis=(0, 1))
    inner = GRID[(GRID[:, 0] > 10) & (GRID[:, 0] < 50) & (GRID[:, 1] > 10) & (GRID[:, 1] < 30)]
    path = fixed_answer(tmp_path / "m.onnx", inner, inner, np.ones(len(inner)))
    raw = match(path, image, moved)
    np.testing.assert_array_equal(raw.photo_pixels, raw.render_pixels)
    matches = match(path, image, moved, OnnxMatcherSettings(polish=PolishSettings(window=11)))
    shift = np.median(matches.render_pixels - matches.photo_pixels, axis=0)
    np.testing.assert_allclose(shift, [1, 2], atol=0.1)


ONE = [[5.0, 5.0]]
BROKEN: dict[str, tuple[Any, Any, Any, str]] = {
    "NaN": ([[np.nan, 5]], ONE, [1], "output points0 holds values that are not finite"),
    "infinite": (ONE, [[5, np.inf]], [1], "output points1 holds values that are not finite"),
    "NaN score": (ONE, ONE, [np.nan], "output scores holds values that are not finite"),
    "outside": ([[5, 45]], ONE, [1], r"1 of 1 points0 lie outside of the 60x40.*\(5\.0, 45\.0\)"),
    "negative": (ONE, [[-3, 5]], [1], "points1 lie outside"),
    "unequal": (ONE, ONE * 2, [1], r"points1 \(2, 2\), scores \(1,\) instead of"),
    "fewer scores": (ONE * 2, ONE * 2, [1], "instead of points0"),
    "batched": ([ONE], [ONE], [[1]], "points0 is .*without a batch dimension"),
    "a scalar": (ONE, ONE, 1.0, r"scores \(\) instead of"),
    "threes": ([[1, 2, 3]], [[1, 2, 3]], [1], r"points0 \(1, 3\)"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_answers_that_break_the_contract(name: str, tmp_path: Path) -> None:
    points0, points1, scores, message = BROKEN[name]
    path = computed_shapes(tmp_path / "broken.onnx", points0, points1, scores)
    with pytest.raises(ModelError, match=message) as caught:
        match(path, dot(1, 1), dot(1, 1))
    assert "broken.onnx" in str(caught.value)


def computed_shapes(path: Path, points0: Any, points1: Any, scores: Any) -> Path:
    """A matcher that always gives the same, in shapes that only show when it runs."""
    node = onnx.helper.make_node
    nodes = [
        node("ReduceMin", ["image0"], ["least"], keepdims=0),
        constant("none", 0.0),
        node("Mul", ["least", "none"], ["zero"]),
        node("Cast", ["zero"], ["offset"], to=onnx.TensorProto.INT64),
    ]
    for name, value in (("points0", points0), ("points1", points1), ("scores", scores)):
        nodes += [
            constant(f"{name}_values", value),
            constant(f"{name}_constant", np.shape(value), np.int64),
            node("Add", [f"{name}_constant", "offset"], [f"{name}_shape"]),
            node("Reshape", [f"{name}_values", f"{name}_shape"], [name]),
        ]
    write(path, nodes)
    model = onnx.load(path)
    for output in model.graph.output:
        output.type.tensor_type.ClearField("shape")
    path.write_bytes(model.SerializeToString())
    return path


def test_points_within_a_pixel_of_the_image_are_only_dropped(tmp_path: Path) -> None:
    points = [[5, 5], [59.9, 20], [-0.8, 20], [20, 40.2], [59.5, 39.5]]
    path = fixed_answer(tmp_path / "m.onnx", points, [[6, 6]] * 5, np.arange(5))
    for valid in (None, np.ones((40, 60), dtype=bool)):
        matcher = OnnxMatcher(path, PLAIN)
        image = matcher.prepare(dot(1, 1), valid)
        np.testing.assert_array_equal(matcher.match(image, image).scores, [0, 4])


DECLARED: dict[str, tuple[dict[str, Any], str]] = {
    "inputs": ({"inputs": ("a", "b")}, "takes a, b; a matcher takes image0 and image1"),
    "one input": ({"inputs": ("image0",)}, "takes image0; a matcher"),
    "channels": ({"image": (1, 4, "H", "W")}, "with 1 or 3 channels"),
    "open channels": ({"image": (1, "C", "H", "W")}, "with 1 or 3 channels"),
    "batch": ({"image": (2, 1, "H", "W")}, r"shape \(1, 1 or 3, H, W\)"),
    "rank": ({"image": (1, "H", "W")}, r"shape \(1, 1 or 3, H, W\)"),
    "outputs": (
        {"outputs": [("points0", ("N", 2)), ("points1", ("N", 2))]},
        "gives points0, points1, but no scores",
    ),
    "columns": (
        {"outputs": [("points0", ("N", 4)), ("points1", ("N", 2)), ("scores", ("N",))]},
        r"points0 is a .* of shape \[3, 4\]; export it as float32 of shape \(N, 2\)",
    ),
}


@pytest.mark.parametrize("name", DECLARED)
def test_files_of_another_form(name: str, tmp_path: Path) -> None:
    more, message = DECLARED[name]
    points = np.zeros((3, 4)) if name == "columns" else np.zeros((3, 2))
    path = fixed_answer(tmp_path / "other.onnx", points, np.zeros((3, 2)), np.ones(3), **more)
    with pytest.raises(ModelError, match=message):
        OnnxMatcher(path, PLAIN)


def test_whole_numbers_are_refused(tmp_path: Path) -> None:
    values = {"points0": ONE, "points1": ONE, "scores": [1]}
    nodes = [constant(name, value, np.int64) for name, value in values.items()]
    path = write(tmp_path / "whole.onnx", nodes, kind=onnx.TensorProto.INT64)
    with pytest.raises(ModelError, match=r"points0 is a tensor\(int64\)"):
        OnnxMatcher(path)


def test_missing_damaged_and_too_new_files(tmp_path: Path) -> None:
    path = tmp_path / "m.onnx"
    with pytest.raises(ModelError, match="is missing, or no file; give the path of an ONNX file"):
        OnnxMatcher(path)
    whole = fixed_answer(path, ONE, ONE, [1]).read_bytes()
    for data in (b"", b"hello", whole[: len(whole) // 2]):
        path.write_bytes(data)
        with pytest.raises(ModelError, match=r"m\.onnx"):
            OnnxMatcher(path)
    with pytest.raises(ModelError, match="needs a newer onnxruntime"):
        OnnxMatcher(fixed_answer(path, ONE, ONE, [1], opset=99))


def test_a_network_that_cannot_take_the_size(tmp_path: Path) -> None:
    """One that reshapes its image to 32 columns."""
    node = onnx.helper.make_node
    nodes = [
        constant("columns", [-1, 32], np.int64),
        node("Reshape", ["image0", "columns"], ["rows"]),
        node("ReduceMax", ["rows"], ["scores"], axes=[0, 1], keepdims=0),
        *(constant(f"points{i}", ONE) for i in range(2)),
    ]
    path = write(tmp_path / "m.onnx", nodes)
    with pytest.raises(ModelError, match=r"cannot be run on images of \(1, 1, 41, 61\).*multiple"):
        match(path, dot(1, 1, 61, 41), dot(1, 1, 61, 41))


def test_the_json_file_beside(tmp_path: Path) -> None:
    path = fixed_answer(tmp_path / "m.onnx", ONE, ONE, [1])
    beside = tmp_path / "m.json"
    for text, settings in (
        ("{}", OnnxMatcherSettings()),
        ('{"top_left_pixel_centre": 0.5, "polish": false}', HALF),
        ('{"multiple_of": 8, "polish": true}', OnnxMatcherSettings(multiple_of=8)),
    ):
        beside.write_text(text)
        assert OnnxMatcher(path)._settings == settings
    beside.write_text(json.dumps({"top_left_pixel_centre": 0.5, "polish": False}))
    np.testing.assert_array_equal(match(path, dot(1, 1), dot(1, 1), None).photo_pixels, ONE)
    matcher = make_matcher(f"onnx:{path}")
    assert isinstance(matcher, OnnxMatcher)
    assert matcher._settings == HALF


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "Expecting value"),
        ("[]", "must be an object with some of top_left_pixel_centre, multiple_of, polish"),
        ('{"centre": 0}', "must be an object with some of"),
        ('{"top_left_pixel_centre": 1}', "must be 0 or 0.5, not 1"),
        ('{"top_left_pixel_centre": "0.5"}', "must be 0 or 0.5"),
        ('{"multiple_of": 0}', "must be a whole number, 1 or more"),
        ('{"multiple_of": 8.0}', "must be a whole number, 1 or more"),
        ('{"polish": "no"}', "polish must be true or false"),
    ],
)
def test_a_json_file_that_cannot_be_used(text: str, message: str, tmp_path: Path) -> None:
    path = fixed_answer(tmp_path / "m.onnx", ONE, ONE, [1])
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(ModelError, match=message) as caught:
        OnnxMatcher(path)
    assert "m.json" in str(caught.value)


def test_impossible_settings() -> None:
    with pytest.raises(SettingsError, match=r"must be 0 or 0\.5, not 0\.25"):
        OnnxMatcherSettings(top_left_pixel_centre=0.25)
    with pytest.raises(SettingsError, match="must be a whole number, 1 or more"):
        OnnxMatcherSettings(multiple_of=-1)


def test_without_onnxruntime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = fixed_answer(tmp_path / "m.onnx", ONE, ONE, [1])
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingDependencyError, match="pip install onnxruntime"):
        OnnxMatcher(path)
