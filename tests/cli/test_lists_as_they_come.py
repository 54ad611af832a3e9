# SPDX-License-Identifier: Apache-2.0
"""Whole runs on photos as they come: blanks in names, a folder, names alone, half the size."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe.batch.to_files import write_poses
from gscpe.cli.main import main
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.photos import write_image
from gscpe.poses.hloc import format_pose, read_poses
from gscpe.scene import save_map
from gscpe.scene.query_list import read_query_list

CAMERA = room_camera(240, 180)
POSES = {
    "my photo 1.png": se3.exp([0.05, -0.03, 0.04, 0.02, -0.02, 0.03]) @ ROOM_POSE,
    "seq 2/photo b.png": se3.exp([-0.04, 0.02, 0.05, -0.02, 0.03, 0.0]) @ ROOM_POSE,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """room.gsmap, photos/ and truth.txt."""
    folder = tmp_path_factory.mktemp("lists")
    save_map(room_map(), folder / "room.gsmap")
    for name, pose in POSES.items():
        photo = room().shoot(CAMERA, pose).uint8
        write_image(folder / "photos" / name, photo)
        half = cv2.resize(photo, (120, 90), interpolation=cv2.INTER_AREA)
        write_image(folder / "photos_2" / name, np.asarray(half, np.uint8))
    lines = [f"{name} {format_pose(pose)}\n" for name, pose in POSES.items()]
    (folder / "truth.txt").write_text("".join(lines))
    return folder


def run(folder: Path, output: Path, *more: str, photos: str = "photos") -> int:
    paths = str(folder / "room.gsmap"), str(folder / photos), str(output)
    return main(["localize", paths[0], "--images", paths[1], "--output", paths[2], *more])


def check(output: Path) -> None:
    found = read_poses(output)
    assert set(found) == set(POSES)
    for name, pose in found.items():
        error = pose_difference(pose, POSES[name])
        assert error.distance < 1e-2
        assert error.degrees < 0.2


def test_a_list_with_blanks_to_the_end(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Localized, resumed, evaluated, converted."""
    windows = [name.replace("/", "\\") for name in POSES]
    queries, output = tmp_path / "queries.txt", tmp_path / "poses.txt"
    lines = [f"{name} {CAMERA.colmap_text()},\n" for name in windows]
    queries.write_text("".join(lines), encoding="utf-16")
    assert run(folder, output, "--queries", str(queries)) == 0
    check(output)
    details = output.with_suffix(".details.jsonl")
    before = details.read_text()
    output.unlink()
    assert run(folder, output, "--queries", str(queries), "--resume") == 0
    assert details.read_text() == before
    check(output)
    capsys.readouterr()
    for poses in (output, details):
        assert main(["evaluate", str(poses), str(folder / "truth.txt"), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["localized"] == 2
    assert main(["convert-poses", str(details), str(tmp_path / "model")]) == 0


@pytest.mark.parametrize("photos", ["photos", "photos_2"])
@pytest.mark.parametrize("listed", [False, True])
def test_one_camera_for_all(photos: str, listed: bool, folder: Path, tmp_path: Path) -> None:
    """A folder, or names alone; photos of half the size too."""
    more = ["--camera", CAMERA.colmap_text().replace(" ", ",").replace("240", "240.0")]
    if listed:
        (tmp_path / "names.txt").write_text("\n".join(POSES))
        more += ["--queries", str(tmp_path / "names.txt")]
    assert run(folder, tmp_path / "poses.txt", *more, photos=photos) == 0
    check(tmp_path / "poses.txt")


def test_the_camera_of_a_folder_is_estimated(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One from all photos of the size that most have, without those that are damaged; and the same
    when the run is resumed."""
    photos, output = tmp_path / "photos", tmp_path / "poses.txt"
    shutil.copytree(folder / "photos", photos)
    write_image(photos / "other.png", np.zeros((30, 40, 3), np.uint8))
    whole = (photos / next(iter(POSES))).read_bytes()
    (photos / "torn.png").write_bytes(whole[: len(whole) // 2])
    command = ["localize", str(folder / "room.gsmap"), "--images", str(photos)]
    assert main([*command, "--output", str(output), "--workers", "1"]) == 0
    error = capsys.readouterr().err
    assert "other.png is 40x30, but its camera is 240x180" in error
    text = next(line for line in error.splitlines() if line.startswith("camera: "))
    assert text.endswith("(estimated from up to 2 photos)")
    camera = Camera.parse(text.split()[1])
    assert camera.fx == pytest.approx(CAMERA.fx, rel=0.02)
    found = read_poses(output)
    assert set(found) == set(POSES)
    for name, pose in found.items():
        assert pose_difference(pose, POSES[name]).distance < 0.03
    details = [json.loads(line) for line in output.with_suffix(".details.jsonl").open()]
    assert {detail["camera"].replace(" ", ",") for detail in details} == {text.split()[1]}
    assert main([*command, "--output", str(output), "--resume"]) == 0


def test_a_folder_without_a_photo_has_no_camera(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    command = ["localize", str(folder / "room.gsmap"), "--images", str(photos)]
    for message in ("holds no photos", "holds no photo that can be read"):
        assert main([*command, "--output", str(tmp_path / "poses.txt")]) == 2
        assert message in capsys.readouterr().err
        (photos / "a.png").write_bytes(b"no picture")


def test_a_photo_of_another_size_is_named(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And fails alone."""
    photos = tmp_path / "photos"
    write_image(photos / "b 2.png", np.zeros((30, 40, 3), np.uint8))
    (name, pose), *_ = POSES.items()
    write_image(photos / name, room().shoot(CAMERA, pose).uint8)
    output = tmp_path / "poses.txt"
    paths = str(folder / "room.gsmap"), str(photos), str(output)
    command = ["localize", paths[0], "--images", paths[1], "--output", paths[2]]
    assert main([*command, "--camera", CAMERA.colmap_text()]) == 0
    assert list(read_poses(output)) == [name]
    assert "b 2.png is 40x30, but its camera is 240x180" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["photos"], "is a folder; give it as --images"),
        (["--images", "photos", "--camera", "x"], "need --images and --output"),
        (
            ["--queries", "q.txt", "--images", "photos", "--output", "p.txt", "--json"],
            "--json cannot be used with",
        ),
    ],
)
def test_arguments_that_do_not_fit(
    arguments: list[str],
    message: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(folder)
    with pytest.raises(SystemExit):
        main(["localize", "room.gsmap", *arguments])
    assert message in capsys.readouterr().err


def test_a_name_that_no_pose_file_can_hold_ends_a_list_before_it_begins(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "photos").mkdir()
    shutil.copy(folder / "photos" / "my photo 1.png", tmp_path / "photos" / "two\nlines.png")
    words = ["localize", str(folder / "room.gsmap"), "--images", str(tmp_path / "photos")]
    words += ["--camera", CAMERA.colmap_text(), "--output", str(tmp_path / "poses.txt")]
    assert main(words) == 2
    assert "cannot be in a text file of poses" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]


def test_a_name_that_is_no_utf8_is_read_as_it_was_written(tmp_path: Path) -> None:
    name = b"K\xfcche.png".decode("utf-8", errors="surrogateescape")
    details = [{"name": name, "status": "localized", "cam_from_world": format_pose(ROOM_POSE)}]
    write_poses(details, tmp_path / "poses.txt", "final")
    assert list(read_poses(tmp_path / "poses.txt")) == [name]
    (tmp_path / "list.txt").write_bytes(b"K\xfcche.png\n")
    assert [query.name for query in read_query_list(tmp_path / "list.txt", CAMERA)] == [name]
