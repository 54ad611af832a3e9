# SPDX-License-Identifier: Apache-2.0
"""Bad input: exit status 2 and exactly one line that names what is wrong. Never a traceback."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Callable

import numpy as np
import pytest
from helpers import random_scene, splat_columns, splat_table, write_splat, write_table
from scenes import ROOM_POSE, room, room_camera, room_map, write_colmap_model

from gscpe.cli.main import main
from gscpe.photos import write_image
from gscpe.poses.hloc import format_pose
from gscpe.scene import open_map, save_map

CAMERA = room_camera(60, 45)
CAMERA_WORDS = CAMERA.colmap_text()
POSE = format_pose(ROOM_POSE)


@dataclass(frozen=True)
class Place:
    """A folder with good input of every kind, for one thing to be spoilt."""

    folder: Path

    def build_map(self) -> list[str]:
        paths = [str(self.folder / name) for name in ("splat.ply", "sparse", "photos", "new.gsmap")]
        splat, sparse, photos, output = paths
        return ["build-map", splat, "--colmap", sparse, "--images", photos, "--output", output]

    def localize(self, camera: str = CAMERA_WORDS) -> list[str]:
        map_, photo = self.folder / "room.gsmap", self.folder / "photos" / "a.png"
        return ["localize", str(map_), str(photo), "--camera", camera]

    def localize_list(self) -> list[str]:
        paths = [str(self.folder / n) for n in ("room.gsmap", "queries.txt", "photos", "poses.txt")]
        map_, queries, photos, output = paths
        return ["localize", map_, "--queries", queries, "--images", photos, "--output", output]

    def render(self, camera: str = CAMERA_WORDS, pose: str = POSE) -> list[str]:
        map_, output = str(self.folder / "room.gsmap"), str(self.folder / "pictures")
        return ["render", map_, "--pose", pose, "--camera", camera, "--output", output]

    def evaluate(self) -> list[str]:
        return ["evaluate", str(self.folder / "poses.txt"), str(self.folder / "truth.txt")]


@pytest.fixture
def place(tmp_path: Path) -> Place:
    rng = np.random.default_rng(0)
    write_splat(tmp_path / "splat.ply", random_scene(rng, 50, 1))
    save_map(room_map(), tmp_path / "room.gsmap")
    write_colmap_model(tmp_path / "sparse", CAMERA, {"a.png": ROOM_POSE})
    write_image(tmp_path / "photos" / "a.png", room().shoot(CAMERA, ROOM_POSE).uint8)
    (tmp_path / "queries.txt").write_text(f"a.png {CAMERA_WORDS}\n")
    (tmp_path / "truth.txt").write_text(f"a.png {POSE}\n")
    (tmp_path / "poses.txt").write_text(f"a.png {POSE}\n")
    (tmp_path / "file").write_text("a regular file\n")
    return Place(tmp_path)


def spoil(path: Path, change: Callable[[bytes], bytes]) -> None:
    path.write_bytes(change(path.read_bytes()))


def nan_splat(path: Path) -> None:
    table = splat_table(random_scene(np.random.default_rng(0), 50, 1))
    table[:30, 0] = np.nan
    write_table(path, splat_columns(1), table)


def flipped(data: bytes) -> bytes:
    half = len(data) // 2
    return data[:half] + bytes([data[half] ^ 255]) + data[half + 1 :]


SPOILT_FILES: dict[str, tuple[str, Callable[[Path], object], str]] = {
    # what is run, what is spoilt, and what must be said
    "splat missing": ("build_map", lambda p: (p / "splat.ply").unlink(), "does not exist"),
    "splat truncated": (
        "build_map",
        lambda p: spoil(p / "splat.ply", lambda d: d[: len(d) // 2]),
        "not a readable PLY",
    ),
    "splat is a text": (
        "build_map",
        lambda p: (p / "splat.ply").write_text("hello\n"),
        "not a readable PLY",
    ),
    "splat is a point cloud": (
        "build_map",
        lambda p: write_table(p / "splat.ply", ["x", "y", "z"], np.zeros((5, 3), np.float32)),
        "not a Gaussian splat",
    ),
    "splat has NaN": ("build_map", lambda p: nan_splat(p / "splat.ply"), "30 hold NaN or infinite"),
    "splat is empty": (
        "build_map",
        lambda p: write_table(p / "splat.ply", splat_columns(1), np.zeros((0, 27), np.float32)),
        "empty",
    ),
    "model missing": (
        "build_map",
        lambda p: (p / "sparse").rename(p / "elsewhere"),
        "is not a folder",
    ),
    "model without cameras": (
        "build_map",
        lambda p: (p / "sparse" / "cameras.txt").unlink(),
        "has no cameras.bin or cameras.txt",
    ),
    "model damaged": (
        "build_map",
        lambda p: (p / "sparse" / "images.txt").write_text("1 2 three\n\n"),
        "COLMAP model",
    ),
    "model without photos": (
        "build_map",
        lambda p: (p / "sparse" / "images.txt").write_text("# none\n"),
        "no photo with a pose",
    ),
    "model of other photos": (
        "build_map",
        lambda p: (p / "photos" / "a.png").rename(p / "photos" / "b.png"),
        "the first is a.png",
    ),
    "model of a camera that is not known": (
        "build_map",
        lambda p: (p / "sparse" / "cameras.txt").write_text("1 FOV 60 45 50 50 30 22 1\n"),
        "'FOV' is not supported",
    ),
    "reference photo of another size": (
        "build_map",
        lambda p: write_image(p / "photos" / "a.png", np.zeros((9, 9, 3), np.uint8)),
        "is 9x9, but its camera is 60x45",
    ),
    "reference photo is a text": (
        "build_map",
        lambda p: (p / "photos" / "a.png").write_text("hello"),
        "is not an image",
    ),
    "map output is a file": (
        "build_map",
        lambda p: (p / "new.gsmap").write_text("precious"),
        "is not a gscpe map",
    ),
    "photo missing": ("localize", lambda p: (p / "photos" / "a.png").unlink(), "cannot be read"),
    "photo is a text": (
        "localize",
        lambda p: (p / "photos" / "a.png").write_text("hello"),
        "is not an image",
    ),
    "map missing": (
        "localize",
        lambda p: (p / "room.gsmap").rename(p / "elsewhere"),
        "is not a gscpe map",
    ),
    "map without manifest": (
        "render",
        lambda p: (p / "room.gsmap" / "map.json").unlink(),
        "has no map.json",
    ),
    "map of the future": (
        "localize",
        lambda p: spoil(
            p / "room.gsmap" / "map.json",
            lambda d: d.replace(b'"version": 4', b'"version": 99'),
        ),
        "version 99",
    ),
    "map damaged": (
        "localize",
        lambda p: spoil(p / "room.gsmap" / "gaussians.npz", flipped),
        "is damaged",
    ),
    "map incomplete": (
        "render",
        lambda p: (p / "room.gsmap" / "retrieval.npz").unlink(),
        "retrieval.npz cannot be read",
    ),
    "queries missing": ("localize_list", lambda p: (p / "queries.txt").unlink(), "cannot be read"),
    "queries empty": ("localize_list", lambda p: (p / "queries.txt").write_text(""), "is empty"),
    "queries malformed": (
        "localize_list",
        lambda p: (p / "queries.txt").write_text(f"a.png {CAMERA_WORDS}\nb.png PINHOLE 6\n"),
        "queries.txt, line 2: camera",
    ),
    "query folder missing": (
        "localize_list",
        lambda p: (p / "photos").rename(p / "elsewhere"),
        "is not a folder",
    ),
    "poses missing": ("evaluate", lambda p: (p / "poses.txt").unlink(), "cannot be read"),
    "poses malformed": (
        "evaluate",
        lambda p: (p / "poses.txt").write_text("a.png 1 0 0\n"),
        "poses.txt, line 1: expected",
    ),
    "poses of other photos": (
        "evaluate",
        lambda p: (p / "poses.txt").write_text(f"b.png {POSE}\n"),
        "no estimate has a name of the truth list",
    ),
    "truth empty": ("evaluate", lambda p: (p / "truth.txt").write_text(""), "truth list is empty"),
}


def check_refused(command: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1, err
    assert err.startswith(f"gscpe {command[0]}: ")
    assert expected in err


@pytest.mark.parametrize("case", SPOILT_FILES)
def test_spoilt_files(case: str, place: Place, capsys: pytest.CaptureFixture[str]) -> None:
    command, spoil_it, expected = SPOILT_FILES[case]
    spoil_it(place.folder)
    check_refused(getattr(Place, command)(place), expected, capsys)


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        ("PINHOLE,640,480,525,525,320,240", "is 60x45, but its camera is 640x480"),
        ("PINHOLE,60,45,50,50,30", "PINHOLE takes 4 parameters"),
        ("FOV,60,45,50,50,30,22,1", "camera model 'FOV' is not supported"),
        ("525,60,45", "is not supported"),
        (" ", "is not of the form"),
        ("PINHOLE,60,45,fifty,50,30,22", "is not of the form"),
        ("PINHOLE,60,45,-50,50,30,22", "focal lengths must be positive"),
        ("PINHOLE,60,45,nan,50,30,22", "must be finite"),
        ("PINHOLE,0,45,50,50,30,22", "camera size must be positive"),
    ],
)
def test_wrong_cameras(
    camera: str, expected: str, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    check_refused(place.localize(camera), expected, capsys)


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        ("1 0 0 0 0 0", "is not of the form qw qx qy qz tx ty tz"),
        ("one 0 0 0 0 0 0", "is not of the form"),
        ("0 0 0 0 0 0 0", "quaternion of length zero"),
        ("1 0 0 0 inf 0 0", "not finite"),
    ],
)
def test_wrong_poses(
    pose: str, expected: str, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    check_refused(place.render(pose=pose), expected, capsys)


def test_rendering_with_a_distorted_camera(
    place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = "SIMPLE_RADIAL,60,45,50,30,22,0.1"
    check_refused(place.render(camera), "pinhole", capsys)


@pytest.mark.parametrize("command", ["build_map", "localize_list", "render"])
def test_output_below_a_regular_file(
    command: str, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = getattr(Place, command)(place)
    arguments[-1] = str(place.folder / "file" / "below" / "it")
    check_refused(arguments, "cannot be written", capsys)
    assert (place.folder / "file").read_text() == "a regular file\n"


@pytest.mark.parametrize("option", ["--coarse-output", "--details"])
def test_other_outputs_below_a_regular_file(
    option: str, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [*place.localize_list(), option, str(place.folder / "file" / "below")]
    check_refused(arguments, "cannot be written", capsys)
    assert (place.folder / "poses.txt").read_text() == f"a.png {POSE}\n"  # not lost


def test_a_wrong_unit(place: Place, capsys: pytest.CaptureFixture[str]) -> None:
    for unit in ("0", "-1", "nan", "inf"):
        command = [*place.build_map(), f"--metres-per-unit={unit}"]
        check_refused(command, "metres_per_unit must be", capsys)


def test_build_map_wants_photos_or_says_that_there_are_none(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    splat, output = tmp_path / "room.ply", tmp_path / "room.gsmap"
    write_splat(splat, room_map().scene)
    command = ["build-map", str(splat), "--output", str(output)]
    for options in ([], ["--colmap", "model"], ["--no-references", "--images", "photos"]):
        with pytest.raises(SystemExit) as error:
            main([*command, *options])
        assert error.value.code == 2
        assert "--colmap and --images, or --no-references" in capsys.readouterr().err
    assert main([*command, "--no-references"]) == 0
    assert "no reference photos" in capsys.readouterr().out
    assert len(open_map(output).references) == 0
