# SPDX-License-Identifier: Apache-2.0
"""``gscpe build-map`` where splat and model do not fit: refused, fitted, transformed, checked."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers import write_splat
from scenes import ROOM_POSE, room, room_camera, room_map, write_colmap_model

from gscpe.cli.main import main
from gscpe.geometry import pose_difference, se3
from gscpe.geometry.similarity_transform import Similarity
from gscpe.photos import write_image
from gscpe.scene import open_map
from gscpe.scene.moved import move_scene

CAMERA = room_camera(240, 180)
POSES = {
    f"{i}.png": se3.exp([0.04 * i - 0.08, 0.03 * (i % 2), 0, 0, 0.015 * i, 0]) @ ROOM_POSE
    for i in range(4)
}
SPLAT_FROM_MODEL = Similarity(
    0.8, se3.exp([0, 0, 0, 0.02, -0.03, 0.01])[:3, :3], np.array([0.05, 0.02, 0.4])
)


@dataclass(frozen=True)
class Place:
    folder: Path

    def build(self, *options: str) -> int:
        paths = [str(self.folder / name) for name in ("splat.ply", "sparse", "photos", "m.gsmap")]
        splat, sparse, photos, output = paths
        command = ["build-map", splat, "--colmap", sparse, "--images", photos, "--output", output]
        return main([*command, *options])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Photos and their model; the splat was moved."""
    folder = tmp_path_factory.mktemp("moved")
    write_splat(folder / "splat.ply", move_scene(room_map().scene, SPLAT_FROM_MODEL))
    write_colmap_model(folder / "sparse", CAMERA, POSES)
    for name, pose in POSES.items():
        write_image(folder / "photos" / name, room().shoot(CAMERA, pose, 2).uint8)
    transform = {
        "transform": np.column_stack(
            [SPLAT_FROM_MODEL.rotation, SPLAT_FROM_MODEL.translation / SPLAT_FROM_MODEL.scale]
        ).tolist(),
        "scale": SPLAT_FROM_MODEL.scale,
    }
    (folder / "dataparser_transforms.json").write_text(json.dumps(transform))
    return Place(folder)


def test_a_moved_splat_is_refused_with_numbers(
    place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    assert place.build() == 2
    err = capsys.readouterr().err
    assert "the splat is 0.8" in err or "the splat is 0.79" in err
    assert "--fit" in err
    assert not (place.folder / "m.gsmap").exists()


def test_without_the_checks_the_map_is_written_as_it_is(place: Place) -> None:
    assert place.build("--no-check") == 0
    assert (place.folder / "m.gsmap" / "map.json").is_file()


@pytest.mark.parametrize("poses_in", ["splat", "model"])
@pytest.mark.parametrize("how", ["fit", "transform"])
def test_it_is_mended(
    how: str, poses_in: str, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(place.folder / "dataparser_transforms.json")
    options = ["--fit"] if how == "fit" else ["--transform", file]
    assert place.build(*options, "--poses-in", poses_in) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert ("moved, for against" in out) == (how == "fit")
    built = open_map(place.folder / "m.gsmap").world_references
    wanted = np.stack(list(POSES.values()))
    if poses_in == "splat":
        wanted = SPLAT_FROM_MODEL.cam_from_b(wanted)
    for pose, true in zip(built.cam_from_world, wanted, strict=True):
        off = pose_difference(pose, true)
        assert off.distance < (6e-3 if how == "fit" and poses_in == "splat" else 1e-9)


def test_a_map_whose_references_do_not_come_back_has_a_status_of_its_own(
    place: Place, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The measuring of the frames is put off, so that the check of the finished map must tell."""
    monkeypatch.setattr("gscpe.cli.build_map.check_frames", lambda *_, **__: None)
    assert place.build() == 4
    err = capsys.readouterr().err
    assert "is written, but it is not good: 0 of 4 reference photos" in err
    assert (place.folder / "m.gsmap" / "map.json").is_file()


@pytest.mark.parametrize(
    "options",
    [["--poses-in", "model"], ["--no-references", "--fit"]],
)
def test_options_that_contradict_each_other(
    options: list[str], place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(place.folder / name) for name in ("splat.ply", "n.gsmap")]
    command = ["build-map", paths[0], "--output", paths[1], *options]
    if "--no-references" not in options:
        command += ["--colmap", str(place.folder / "sparse"), "--images", str(place.folder)]
    with pytest.raises(SystemExit) as stopped:
        main(command)
    assert stopped.value.code == 2
    assert "--fit" in capsys.readouterr().err
