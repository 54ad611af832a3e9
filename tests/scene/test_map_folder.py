# SPDX-License-Identifier: Apache-2.0
"""The map folder: saved and opened exactly, moved freely, and its damage noticed."""

from __future__ import annotations

import contextlib
import json
import shutil
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import assert_same_map, check_one_wrong_byte, some_map

from gscpe.errors import MapError, OutputError, PoseError
from gscpe.geometry import Camera
from gscpe.scene import GlobalDescriptors, Map, MapFrame, References, open_map, save_map

FILES = ("gaussians.npz", "map.json", "references.json", "retrieval.npz")


@pytest.fixture
def map_(rng: np.random.Generator) -> Map:
    return some_map(rng)


@pytest.fixture
def folder(tmp_path: Path, map_: Map) -> Path:
    folder = tmp_path / "my maps" / "kitchen.gsmap"
    save_map(map_, folder)
    return folder


def test_round_trip(folder: Path, map_: Map) -> None:
    assert_same_map(open_map(folder), map_)
    assert_same_map(open_map(str(folder)), map_)
    assert sorted(entry.name for entry in folder.iterdir()) == sorted(FILES)
    assert [entry.name for entry in folder.parent.iterdir()] == [folder.name]


def test_cameras_made_of_numpy_numbers(tmp_path: Path, map_: Map) -> None:
    camera = Camera(640, 480, *np.array([500.1, 510.2, 320.3, 240.4]))
    references = References(
        map_.references.names, map_.references.cam_from_world, (camera,) * len(map_.references)
    )
    save_map(Map(map_.scene, references, map_.descriptors), tmp_path / "a.gsmap")
    assert open_map(tmp_path / "a.gsmap").references.cameras[0] == camera


@pytest.mark.parametrize("metres_per_unit", [None, 1.0, 1 / 3])
def test_the_unit_is_kept(metres_per_unit: float | None, map_: Map, tmp_path: Path) -> None:
    save_map(replace(map_, frame=MapFrame(metres_per_unit=metres_per_unit)), tmp_path / "a.gsmap")
    assert open_map(tmp_path / "a.gsmap").metres_per_unit == metres_per_unit


@pytest.mark.parametrize("metres_per_unit", [0.0, -1.0, np.nan, np.inf])
def test_impossible_units(metres_per_unit: float, map_: Map) -> None:
    with pytest.raises(MapError, match="metres per unit must be positive"):
        MapFrame(metres_per_unit=metres_per_unit)


def test_a_moved_folder_opens(folder: Path, map_: Map, tmp_path: Path) -> None:
    shutil.move(folder, tmp_path / "elsewhere")
    assert_same_map(open_map(tmp_path / "elsewhere"), map_)


def test_a_map_replaces_a_map(folder: Path, rng: np.random.Generator) -> None:
    other = some_map(rng, count=7, references=2)
    save_map(other, folder)
    assert_same_map(open_map(folder), other)
    assert [entry.name for entry in folder.parent.iterdir()] == [folder.name]


def test_an_empty_folder_is_taken(tmp_path: Path, map_: Map) -> None:
    (tmp_path / "empty").mkdir()
    save_map(map_, tmp_path / "empty")
    assert_same_map(open_map(tmp_path / "empty"), map_)


def test_neighbours_are_left_alone(tmp_path: Path, map_: Map) -> None:
    neighbour = tmp_path / "a.gsmap.partial"
    neighbour.mkdir()
    save_map(map_, tmp_path / "a.gsmap")
    assert {entry.name for entry in tmp_path.iterdir()} == {"a.gsmap", neighbour.name}


def test_the_working_directory_is_a_folder_too(
    tmp_path: Path, map_: Map, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Saved there, or refused as an output: nothing else."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with contextlib.suppress(OutputError):
        save_map(map_, ".")
        assert_same_map(open_map(tmp_path / "here"), map_)
    assert [entry.name for entry in tmp_path.iterdir()] == ["here"]


@pytest.mark.parametrize("name", FILES)
def test_one_wrong_byte_is_noticed(name: str, folder: Path, map_: Map) -> None:
    check_one_wrong_byte(folder / name, 60, lambda opened: assert_same_map(opened, map_))


@pytest.mark.parametrize("name", FILES)
def test_truncated_files_are_noticed(name: str, folder: Path) -> None:
    path = folder / name
    data = path.read_bytes()
    for length in (0, 1, len(data) // 2, len(data) - 2):
        path.write_bytes(data[:length])
        with pytest.raises(MapError, match="damaged") as caught:
            open_map(folder)
        assert str(folder) in str(caught.value)


@pytest.mark.parametrize("name", FILES)
def test_missing_files_are_noticed(name: str, folder: Path) -> None:
    (folder / name).unlink()
    with pytest.raises(MapError) as caught:
        open_map(folder)
    assert str(folder) in str(caught.value)
    assert name in str(caught.value)


def rewrite(folder: Path, name: str, data: bytes) -> None:
    """Replaces a file and its checksum, as an editor of maps would."""
    (folder / name).write_bytes(data)
    manifest = json.loads((folder / "map.json").read_text())
    manifest["files"][name] = {"bytes": len(data), "crc32": zlib.crc32(data)}
    (folder / "map.json").write_text(json.dumps(manifest))


@pytest.mark.parametrize("name", ["gaussians.npz", "references.json", "retrieval.npz"])
@pytest.mark.parametrize(
    "data",
    [b"", b"PK\x03\x04 not a zip", b"null", b"[1]", b"{}", b'[{"name": "a"}]', b"\x93NUMPY"],
)
def test_nonsense_with_a_right_checksum(name: str, data: bytes, folder: Path) -> None:
    rewrite(folder, name, data)
    with pytest.raises(MapError) as caught:
        open_map(folder)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        {"name": None, "camera": 5},
        {"camera": "FOV 640 480 1 1 1 1 1"},
        {"cam_from_world": [[1, 0], [0, 1]]},
        {"cam_from_world": np.diag([2.0, 1.0, 1.0, 1.0]).tolist()},
        {"cam_from_world": "identity"},
    ],
)
def test_impossible_references_are_noticed(change: dict[str, object], folder: Path) -> None:
    entries = json.loads((folder / "references.json").read_text())
    entries[2].update(change)
    rewrite(folder, "references.json", json.dumps(entries).encode())
    with pytest.raises(MapError, match="damaged"):
        open_map(folder)


@pytest.mark.parametrize(
    ("version", "remedy"), [(3, "build the map again"), (5, "update gscpe"), (99, "update gscpe")]
)
def test_other_versions_say_what_to_do(version: int, remedy: str, folder: Path) -> None:
    manifest = json.loads((folder / "map.json").read_text())
    (folder / "map.json").write_text(json.dumps(manifest | {"version": version}))
    with pytest.raises(MapError, match=f"version {version}.*{remedy}"):
        open_map(folder)


MANIFESTS = [
    *("", "[]", "3", "{}", '{"format": 1}', '{"version": 1}'),
    '{"format": "gscpe map", "version": 1}',
    '{"format": "gscpe map", "version": "x"}',
    '{"format": "gscpe map", "version": null}',
    '{"format": "gscpe map", "version": Infinity}',
    '{"format": "gscpe map", "version": 1, "files": {"gaussians.npz": 3}}',
    '{"format": "a tile map", "version": 1}',
]


@pytest.mark.parametrize("manifest", MANIFESTS)
def test_manifests_of_other_kinds(manifest: str, folder: Path) -> None:
    (folder / "map.json").write_text(manifest)
    with pytest.raises(MapError) as caught:
        open_map(folder)
    assert str(folder) in str(caught.value)


def test_not_a_map(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("hello")
    for path in (tmp_path, tmp_path / "file", tmp_path / "absent"):
        with pytest.raises(MapError, match="is not a gscpe map") as caught:
            open_map(path)
        assert str(path) in str(caught.value)


def test_parts_that_do_not_fit_together(map_: Map) -> None:
    short = GlobalDescriptors(map_.descriptors.vocabulary, map_.descriptors.descriptors[:-1])
    with pytest.raises(MapError, match="one global descriptor for each"):
        Map(map_.scene, map_.references, short)
    poses = map_.references.cam_from_world
    with pytest.raises(MapError, match="as many names as poses"):
        References(map_.references.names[:-1], poses, map_.references.cameras)
    with pytest.raises(PoseError, match="reference room 0/"):
        References(map_.references.names, 2 * poses, map_.references.cameras)
    with pytest.raises(MapError, match="finite"):
        GlobalDescriptors(np.full((4, 128), np.nan, np.float32), map_.descriptors.descriptors)
