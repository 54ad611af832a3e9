# SPDX-License-Identifier: Apache-2.0
"""VLAD of XFeat, and maps that are described by it."""

from __future__ import annotations

import json
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import assert_same_map, some_map
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera

import gscpe.retrieval.methods
from gscpe import Localizer
from gscpe.cli.main import main
from gscpe.errors import MapError, MissingDependencyError, ModelError, SettingsError
from gscpe.features import XFeat, XFeatFeatures
from gscpe.geometry import se3
from gscpe.mapping import MapSettings
from gscpe.photos import Photo, to_photo
from gscpe.retrieval import VladDescriber, describe_references, open_describer, xfeat
from gscpe.scene import GlobalDescriptors, Map, open_map, save_map

CAMERA = room_camera(160, 120)


class FakeXFeat:
    """Finds 1200 descriptors that depend on the image only, best first."""

    calls = 0

    def detect(
        self, image: NDArray[np.uint8], most: int = 4096, *, valid: object = None
    ) -> XFeatFeatures:
        self.calls += 1
        count = 0 if image.max() == image.min() else 1200
        rng = np.random.default_rng(zlib.crc32(image.tobytes()))
        descriptors = rng.normal(size=(count, 64))
        descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
        return XFeatFeatures(
            np.zeros((count, 2))[:most],
            np.linspace(1, 0.5, count, dtype=np.float32)[:most],
            descriptors.astype(np.float32)[:most],
        )


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> FakeXFeat:
    fake = FakeXFeat()
    monkeypatch.setattr(gscpe.retrieval.methods, "xfeat", lambda: xfeat(fake))  # type: ignore[arg-type]
    return fake


def photos() -> list[Photo]:
    turns = (0.0, 0.5, -0.4)
    poses = [se3.exp([0, 0, 0, 0, turn, 0]) @ ROOM_POSE for turn in turns]
    return [to_photo(room().shoot(CAMERA, pose).uint8, CAMERA) for pose in poses]


@pytest.fixture
def known(network: FakeXFeat) -> GlobalDescriptors:
    return describe_references(photos(), "vlad-xfeat")


def test_the_same_vector_by_either_path(known: GlobalDescriptors, network: FakeXFeat) -> None:
    """Features that matching found, of which there are more, or its own."""
    describer = open_describer(known)
    assert known.descriptors.shape == (3, 128 * 64)
    for photo, expected in zip(photos(), known.descriptors, strict=True):
        features = network.detect(photo.rgb, 2048)
        assert len(features) == 1200
        np.testing.assert_array_equal(describer.describe(photo.rgb), expected)
        network.calls = 0
        np.testing.assert_array_equal(describer.describe(photo.rgb, features), expected)
        assert network.calls == 0
        assert np.linalg.norm(expected) == pytest.approx(1.0, abs=1e-5)
    blank = describer.describe(np.full((120, 160, 3), 9, np.uint8))
    np.testing.assert_array_equal(blank, np.zeros(128 * 64))


def saved(known: GlobalDescriptors, folder: Path, compress: bool = False) -> Map:
    map_ = replace(some_map(np.random.default_rng(2), references=3), descriptors=known)
    save_map(map_, folder, compress=compress)
    return map_


@pytest.mark.parametrize("compress", [False, True])
def test_the_map_remembers_the_method(
    compress: bool, known: GlobalDescriptors, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gscpe that does not know the method asks for an update. Opening needs no network,
    localizing does."""
    if compress:
        pytest.importorskip("gaussforge", reason="gaussforge is an optional package")
    saved(known, tmp_path / "m", compress)
    assert json.loads((tmp_path / "m" / "map.json").read_text())["version"] == 4
    monkeypatch.undo()
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path / "no models"))
    opened = open_map(tmp_path / "m")
    assert opened.descriptors.method == "vlad-xfeat"
    np.testing.assert_array_equal(opened.descriptors.vocabulary, known.vocabulary)
    np.testing.assert_allclose(opened.descriptors.descriptors, known.descriptors, atol=1e-3)
    with pytest.raises(ModelError, match="gscpe models install xfeat"):
        Localizer(opened)


def test_maps_that_do_not_say_the_method(known: GlobalDescriptors, tmp_path: Path) -> None:
    """They were written before there were several, and later ones of that method are alike."""
    map_ = saved(replace(known, method="vlad"), tmp_path / "m")
    with np.load(tmp_path / "m" / "retrieval.npz") as arrays:
        assert sorted(arrays.files) == ["descriptors", "vocabulary"]
    assert json.loads((tmp_path / "m" / "map.json").read_text())["version"] == 4
    assert_same_map(open_map(tmp_path / "m"), map_)
    assert open_map(tmp_path / "m").descriptors.method == "vlad"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"method": "netvlad"}, "'netvlad', which this gscpe does not know; update gscpe"),
        ({"method": "vlad"}, r"vocabulary, \(128, 64\), .*are not those of vlad"),
        ({"vocabulary": np.zeros((5, 64), np.float32)}, "are not those of vlad-xfeat"),
        ({"vocabulary": np.zeros((0, 0), np.float32)}, "are not those of vlad-xfeat"),
    ],
)
def test_parts_that_do_not_fit_together(
    change: dict[str, object], message: str, known: GlobalDescriptors
) -> None:
    with pytest.raises(MapError, match=message):
        open_describer(replace(known, **change))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "recipe",
    [*("", "null", "[]", "{}", "3", '{"model": null}'), '{"method": "onnx", "model": {"file": 1}}'],
)
def test_damaged_recipes(recipe: str, known: GlobalDescriptors, tmp_path: Path) -> None:
    saved(known, tmp_path / "m")
    path = tmp_path / "m" / "retrieval.npz"
    with np.load(path) as arrays:
        rest = {name: arrays[name] for name in ("vocabulary", "descriptors")}
    np.savez(path, recipe=np.array(recipe), **rest)
    manifest = json.loads((tmp_path / "m" / "map.json").read_text())
    manifest["files"][path.name]["crc32"] = zlib.crc32(path.read_bytes())
    (tmp_path / "m" / "map.json").write_text(json.dumps(manifest))
    with pytest.raises(MapError, match="damaged"):
        open_map(tmp_path / "m")


def test_unknown_methods_are_refused_early() -> None:
    with pytest.raises(SettingsError, match="there is no retrieval method 'netvlad'"):
        MapSettings(retrieval="netvlad")


def test_the_installed_network(tmp_path: Path) -> None:
    """A photo from nearby is nearest to its place; masked features are left out."""
    try:
        extract = xfeat(XFeat(threads=1))
    except (ModelError, MissingDependencyError) as error:
        pytest.skip(str(error))
    known = describe_references(photos(), "vlad-xfeat")
    describer = VladDescriber(extract, known.vocabulary)
    for index, turn in enumerate((0.0, 0.5, -0.4)):
        pose = se3.exp([0.02, 0.01, 0.02, 0.01, turn + 0.02, 0.01]) @ ROOM_POSE
        query = describer.describe(room().shoot(CAMERA, pose).uint8)
        assert int(np.argmax(known.descriptors @ query)) == index
    nowhere = np.zeros((120, 160), dtype=bool)
    assert not describer.describe(photos()[0].rgb, None, nowhere).any()


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("netvlad", "the methods are vlad, vlad-xfeat, onnx:PATH"),
        ("vlad-xfeat", "gscpe models install xfeat"),
        ("onnx:/nowhere/net.onnx", "net.onnx is missing"),
    ],
)
def test_build_map_refuses_before_it_reads(
    method: str,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path / "no models"))
    command = ["build-map", "absent.ply", "--colmap", "x", "--images", "y", "--retrieval", method]
    assert main([*command, "--output", str(tmp_path / "m")]) != 0
    assert message in capsys.readouterr().err
    assert not (tmp_path / "m").exists()
