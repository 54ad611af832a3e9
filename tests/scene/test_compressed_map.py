# SPDX-License-Identifier: Apache-2.0
"""Compressed maps: what rounding changes, and damage that is noticed."""

from __future__ import annotations

import gzip
import importlib.util
import json
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_same_map, check_one_wrong_byte, random_scene, some_map

from gscpe.cli.main import main
from gscpe.errors import MapError, MissingDependencyError, OutputError
from gscpe.scene import Map, MapFrame, open_map, save_map
from gscpe.scene.map_folder import check_map_output
from gscpe.splats import GaussianScene, compression
from gscpe.splats.compression import outliers
from gscpe.splats.spz import encode_spz

pytest.importorskip("gaussforge", reason="gaussforge is an optional package")

FILES = ("gaussians.json", "gaussians.spz", "map.json", "references.json", "retrieval.npz")


@pytest.fixture
def map_(rng: np.random.Generator) -> Map:
    return some_map(rng)


@pytest.fixture
def folder(tmp_path: Path, map_: Map) -> Path:
    folder = tmp_path / "my maps" / "kitchen.gsmap"
    save_map(map_, folder, compress=True)
    return folder


def scaled(map_: Map, factor: float) -> Map:
    """The map with other lengths; poses stay, since nothing here looks at them."""
    scene = map_.scene
    means, scales = (
        np.asarray(lengths * factor, dtype=np.float32) for lengths in (scene.means, scene.scales)
    )
    return replace(map_, scene=replace(scene, means=means, scales=scales))


def assert_almost_same(opened: Map, map_: Map) -> None:
    """Half a step of each rounding; references and the unit exactly."""
    a, b = opened.scene, map_.scene
    np.testing.assert_allclose(a.means, b.means, rtol=0, atol=np.abs(b.means).max() * 2.0**-22)
    np.testing.assert_allclose(a.scales, b.scales, rtol=0.032)
    np.testing.assert_allclose(a.opacities, b.opacities, atol=0.002)
    np.testing.assert_allclose(a.sh, b.sh, atol=0.014)
    aligned = np.abs(np.sum(a.quaternions * b.quaternions, axis=1))
    assert np.degrees(2 * np.arccos(np.clip(aligned, 0, 1))).max() < 0.25
    assert a.antialiased is b.antialiased
    np.testing.assert_allclose(
        opened.descriptors.descriptors, map_.descriptors.descriptors, rtol=2.0**-11
    )
    assert opened.descriptors.descriptors.dtype == np.float32
    exact = replace(opened, scene=map_.scene, descriptors=map_.descriptors)
    assert_same_map(exact, map_)


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e3, 1e9])
def test_round_trip_at_any_size(size: float, antialiased: bool, map_: Map, tmp_path: Path) -> None:
    map_ = scaled(replace(map_, scene=replace(map_.scene, antialiased=antialiased)), size)
    save_map(map_, tmp_path / "a.gsmap", compress=True)
    assert_almost_same(open_map(tmp_path / "a.gsmap"), map_)
    assert sorted(path.name for path in (tmp_path / "a.gsmap").iterdir()) == sorted(FILES)


@pytest.mark.parametrize("metres_per_unit", [None, 1 / 3])
def test_the_unit_is_kept(metres_per_unit: float | None, map_: Map, tmp_path: Path) -> None:
    save_map(
        replace(map_, frame=MapFrame(metres_per_unit=metres_per_unit)),
        tmp_path / "a",
        compress=True,
    )
    assert open_map(tmp_path / "a").metres_per_unit == metres_per_unit


def test_a_fifth_of_the_size(map_: Map, tmp_path: Path, rng: np.random.Generator) -> None:
    scene = random_scene(rng, 2000, 3)
    scene.sh[:, 1:] *= 0.3  # as faint as in trained splats
    map_ = replace(map_, scene=scene)
    sizes = []
    for name in ("plain", "compressed"):
        save_map(map_, tmp_path / name, compress=name == "compressed")
        sizes.append(sum(file.stat().st_size for file in (tmp_path / name).iterdir()))
    assert sizes[1] < sizes[0] / 5


def test_kinds_replace_each_other(folder: Path, map_: Map) -> None:
    save_map(map_, folder)
    assert_same_map(open_map(folder), map_)
    check_map_output(folder, compress=True)
    save_map(map_, folder, compress=True)
    assert_almost_same(open_map(folder), map_)


def with_values(map_: Map, rows: object, **values: object) -> Map:
    """The map with other values of some Gaussians."""
    scene = map_.scene
    changed = {}
    for name, value in values.items():
        changed[name] = getattr(scene, name).copy()
        changed[name][rows] = value
    return replace(map_, scene=replace(scene, **changed))


OUTLIERS: dict[str, tuple[dict[str, Any], str]] = {
    "far": ({"means": (1e6, 0.0, -3e5)}, "1 far away"),
    "very far": ({"means": (0.0, 9e14, 0.0)}, "1 far away"),
    "huge": ({"scales": (1e14, 1e5, 1e6)}, "1 huge"),
    "bright": ({"sh": 50.0}, "1 of extreme colours"),
    "far and huge": ({"means": 1e8, "scales": 1e8}, "1 far away"),
}


@pytest.mark.parametrize("kind", OUTLIERS)
def test_one_outlier_costs_the_others_nothing(
    kind: str, map_: Map, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It is kept apart, exactly, and a warning says so."""
    values, says = OUTLIERS[kind]
    save_map(with_values(map_, 3, **values), tmp_path / "a", compress=True)
    assert "1 of 30 Gaussians are stored separately" in caplog.text
    assert says in caplog.text
    opened = open_map(tmp_path / "a")
    others = [i for i in range(30) if i != 3]
    assert_almost_same(
        replace(opened, scene=opened.scene.taken(np.arange(29))),
        replace(map_, scene=map_.scene.taken(np.array(others))),
    )
    for name in ("means", "quaternions", "scales", "opacities", "sh"):
        expected = values.get(name, getattr(map_.scene, name)[3])
        last = getattr(opened.scene, name)[29]
        np.testing.assert_array_equal(last, np.broadcast_to(expected, last.shape).astype("f4"))


def test_usual_scenes_have_no_outliers(map_: Map, caplog: pytest.LogCaptureFixture) -> None:
    """Not even where distances and sizes differ ten thousandfold."""
    rng = np.random.default_rng(0)
    size = np.exp(rng.uniform(np.log(1e-3), np.log(10.0), (500, 1))).astype(np.float32)
    scene = random_scene(rng, 500, 3)
    scene = replace(scene, means=scene.means * 100 * size, scales=scene.scales * size)
    assert not outliers(scene, colours=True).rows.any()


def test_scenes_that_cannot_be_compressed(
    map_: Map, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Many far or huge Gaussians are no outliers: the map is refused rather than spoilt."""
    map_ = replace(map_, scene=random_scene(rng, 200, 0))
    cases: tuple[tuple[dict[str, Any], str], ...] = (
        ({"scales": 1e14}, "do not fit|smaller than|of another size"),
        ({"means": rng.uniform(-1e9, 1e9, (100, 3))}, "moved by more than half their size"),
        ({"sh": 50.0}, "of another colour"),
    )
    for values, says in cases:
        with pytest.raises(OutputError, match=f"({says}).*save it plain"):
            save_map(with_values(map_, slice(0, 100), **values), tmp_path / "a", compress=True)
        assert list(tmp_path.iterdir()) == []


def test_what_was_written_is_read_back(
    map_: Map, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A converter that spoils the splat does not go unnoticed."""
    encode = encode_spz

    def spoilt(scene: GaussianScene, exponent: int) -> bytes:
        return encode(replace(scene, means=scene.means[:, ::-1].copy()), exponent)

    monkeypatch.setattr(compression, "encode_spz", spoilt)
    with pytest.raises(OutputError, match="moved by more than half their size"):
        save_map(map_, tmp_path / "a", compress=True)


@pytest.mark.parametrize("apart", ['"!"', '"AAAA"', "3", "null"])
def test_damaged_gaussians_apart(apart: str, folder: Path) -> None:
    rest = json.loads((folder / "gaussians.json").read_text())
    rewrite(folder, "gaussians.json", json.dumps({**rest, "apart": json.loads(apart)}).encode())
    with pytest.raises(MapError, match="damaged"):
        open_map(folder)


def test_without_gaussforge_the_remedy_is_named(
    folder: Path, map_: Map, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    for action in (
        lambda: open_map(folder),
        lambda: save_map(map_, tmp_path / "new", compress=True),
        lambda: check_map_output(tmp_path / "new", compress=True),
    ):
        with pytest.raises(MissingDependencyError, match=r"pip install 'gscpe\[formats\]'"):
            action()
    assert not (tmp_path / "new").exists()
    command = ["build-map", "absent.ply", "--colmap", "x", "--images", "y", "--compress"]
    assert main([*command, "--output", str(tmp_path / "new")]) != 0


@pytest.mark.parametrize("name", FILES)
def test_one_wrong_byte_is_noticed(name: str, folder: Path, map_: Map) -> None:
    check_one_wrong_byte(
        folder / name,
        8 if name == "map.json" else 60,
        lambda opened: assert_almost_same(opened, map_),
    )


@pytest.mark.parametrize("name", FILES)
def test_missing_and_truncated_files_are_noticed(name: str, folder: Path) -> None:
    path = folder / name
    data = path.read_bytes()
    for length in (0, len(data) // 2, len(data) - 2):
        path.write_bytes(data[:length])
        with pytest.raises(MapError, match="damaged"):
            open_map(folder)
    path.unlink()
    with pytest.raises(MapError, match=name):
        open_map(folder)


def rewrite(folder: Path, name: str, data: bytes) -> None:
    """Replaces a file and its checksum, as an editor of maps would."""
    (folder / name).write_bytes(data)
    manifest = json.loads((folder / "map.json").read_text())
    manifest["files"][name] = {"bytes": len(data), "crc32": zlib.crc32(data)}
    (folder / "map.json").write_text(json.dumps(manifest))


def test_damaged_gaussians_with_a_right_checksum(folder: Path) -> None:
    """A valid scene, which Map checks, or a MapError."""
    content = gzip.decompress((folder / "gaussians.spz").read_bytes())
    rng = np.random.default_rng(5)
    for attempt in range(8):
        damaged = bytearray(content)
        damaged[rng.integers(16 if attempt % 2 else len(content))] = rng.integers(256)
        rewrite(
            folder, "gaussians.spz", gzip.compress(damaged[: rng.integers(1, 2 * len(content))])
        )
        try:
            opened = open_map(folder)
        except MapError as error:
            assert str(folder) in str(error)
        else:
            assert np.all(np.isfinite(opened.scene.means))


def of_unit(unit: object, factor: str = "1") -> str:
    frame = f'{{"origin": [0, 0, 0], "scale": 1, "metres_per_unit": {unit}}}'
    return f'{{"factor": {factor}, "near": 0.2, "frame": {frame}}}'


@pytest.mark.parametrize(
    "text",
    [
        *("", "null", "[1]", "{}", '{"factor": 1}', of_unit(1, factor='"x"')),
        *(of_unit(1, factor=factor) for factor in ("0", "-2", "NaN", "1e999", "null")),
        *(of_unit(unit) for unit in ("0", "-2", "NaN", "[]", '"x"')),
        *(of_unit(1, factor=factor) for factor in ("1e-60", "1e60")),
    ],
)
def test_impossible_factors_and_units(text: str, folder: Path) -> None:
    rewrite(folder, "gaussians.json", text.encode())
    with pytest.raises(MapError, match="damaged"):
        open_map(folder)
