# SPDX-License-Identifier: Apache-2.0
"""Input that no one gives on purpose: still one line and exit status 2, and nothing is lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe.cli.main import main
from gscpe.photos import write_image
from gscpe.poses.hloc import format_pose, read_poses
from gscpe.scene import save_map

CAMERA = room_camera(240, 180)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("odd")
    save_map(room_map(), folder / "room.gsmap")
    write_image(folder / "photos" / "a.png", room().shoot(CAMERA, ROOM_POSE).uint8)
    (folder / "queries.txt").write_text(f"a.png {CAMERA.colmap_text()}\n")
    return folder


def localize_list(folder: Path, output: str, *more: str) -> list[str]:
    return [
        *("localize", str(folder / "room.gsmap"), "--queries", str(folder / "queries.txt")),
        *("--images", str(folder / "photos"), "--output", output, *more),
    ]


def check_refused(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1, err
    assert err.startswith(f"gscpe {command[0]}: ")


@pytest.mark.parametrize("output", [".", "/"])
def test_outputs_without_a_name(
    output: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check_refused(localize_list(folder, output), capsys)


@pytest.mark.parametrize("option", ["--details", "--coarse-output"])
def test_two_outputs_in_one_file(
    option: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One would overwrite the other."""
    output = str(tmp_path / "poses.txt")
    check_refused(localize_list(folder, output, option, output), capsys)


@pytest.mark.parametrize(
    "line", ['{"name": "a.png"}', '{"name": "a.png", "status": "localized"}', "[1, 2]", "7", "null"]
)
def test_resuming_from_lines_that_are_no_details(
    line: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They are left out, and the photo is localized."""
    output, details = tmp_path / "poses.txt", tmp_path / "details.jsonl"
    details.write_text(line + "\n")
    assert main(localize_list(folder, str(output), "--details", str(details), "--resume")) == 0
    assert "1 of 1 photos localized" in capsys.readouterr().out
    assert list(read_poses(output)) == ["a.png"]


@pytest.mark.parametrize("backend", ["gl", "cpu"])
def test_pictures_that_are_too_large(
    backend: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["render", str(folder / "room.gsmap"), "--pose", format_pose(np.eye(4))]
    command += ["--camera", "PINHOLE,1000000,1000000,800000,800000,500000,500000"]
    check_refused([*command, "--backend", backend, "--output", str(tmp_path)], capsys)


def test_names_longer_than_files_may_have(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photo, camera = str(folder / "photos" / "a.png"), CAMERA.colmap_text()
    check_refused(["localize", "m" * 300, photo, "--camera", camera], capsys)
    check_refused(localize_list(folder, "p" * 300), capsys)
    check_refused(["evaluate", "e" * 300, "t" * 300], capsys)
    build = ["build-map", "s" * 300, "--colmap", "c" * 300, "--images", "i" * 300]
    check_refused([*build, "--output", str(tmp_path / "m.gsmap")], capsys)


@pytest.mark.parametrize("option", ["--output", "--coarse-output"])
def test_poses_into_an_earlier_runs_details(
    option: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    details = tmp_path / "p.details.jsonl"
    details.write_text("{}\n")
    command = localize_list(folder, str(tmp_path / "q.txt"), option, str(details))
    check_refused(command, capsys)
    assert [path.name for path in tmp_path.iterdir()] == [details.name]
    assert details.read_text() == "{}\n"


def test_a_service_of_far_too_many_workers(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("uvicorn")
    command = ["serve", str(folder / "room.gsmap"), "--port", "0", "--workers", "9999"]
    check_refused(command, capsys)
