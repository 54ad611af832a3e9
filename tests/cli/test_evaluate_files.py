# SPDX-License-Identifier: Apache-2.0
"""``gscpe evaluate`` on files of different forms, and against the 7-Scenes protocol."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import random_pose, simple_camera
from numpy.typing import NDArray

from gscpe.cli.main import main
from gscpe.geometry import se3
from gscpe.poses import PoseFormat, write_pose_file

Poses = dict[str, NDArray[np.float64]]


@pytest.fixture
def truth(rng: np.random.Generator) -> Poses:
    """In no order, as the pseudo ground truth is."""
    return {
        f"seq-{s:02d}/frame-{i:06d}.color.png": random_pose(rng) for i in range(30) for s in (3, 14)
    }


@pytest.fixture
def estimates(truth: Poses, rng: np.random.Generator) -> Poses:
    """From millimetres to decimetres off; some missing, one upside down, one unknown."""
    scales = rng.permutation(np.geomspace(1e-3, 0.2, len(truth)))
    estimates = {
        name: se3.exp(scale * rng.normal(size=6)) @ pose
        for scale, (name, pose) in zip(scales, sorted(truth.items()), strict=True)
    }
    names = list(estimates)
    del estimates[names[7]], estimates[names[8]]
    estimates[names[20]] = se3.exp([0, 0, 0, 0, 0, np.pi]) @ estimates[names[20]]
    estimates["seq-05/frame-000000.color.png"] = np.eye(4)
    return estimates


def evaluated(capsys: pytest.CaptureFixture[str], *arguments: Path | str) -> dict[str, Any]:
    assert main(["evaluate", *map(str, arguments), "--json"]) == 0
    data: dict[str, Any] = json.loads(capsys.readouterr().out)
    return data


def protocol_errors(estimates: Path, truth: Path) -> NDArray[np.float64]:
    """(photos, 2) centimetres and degrees: camera centres, and the axis angle of the relative
    rotation; infinite where a photo of the truth has no estimate. As the evaluation of the
    pseudo ground truth (Brachmann et al., ICCV 2021) defines them, without gscpe."""

    def read(path: Path) -> dict[str, NDArray[np.float64]]:
        poses = {}
        for line in path.read_text().splitlines():
            name, *words = line.split()
            w, x, y, z, *t = map(float, words[:7])
            n = np.sqrt(w * w + x * x + y * y + z * z)
            w, x, y, z = w / n, x / n, y / n, z / n
            cam_from_world = np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), t[0]],
                    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), t[1]],
                    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), t[2]],
                    [0, 0, 0, 1],
                ]
            )
            poses[name] = np.linalg.inv(cam_from_world)
        return poses

    found, errors = read(estimates), []
    for name, true in read(truth).items():
        if name not in found:
            errors.append([np.inf, np.inf])
            continue
        rotation, _ = cv2.Rodrigues(found[name][:3, :3] @ true[:3, :3].T)
        distance = float(np.linalg.norm(found[name][:3, 3] - true[:3, 3]))
        errors.append([100.0 * distance, float(np.degrees(np.linalg.norm(rotation)))])
    return np.array(errors)


def test_the_protocol_of_the_pseudo_ground_truth(
    truth: Poses, estimates: Poses, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Photos of the truth list count, each; the error is the larger of cm and degrees."""
    cameras = dict.fromkeys(truth, simple_camera())
    write_pose_file(tmp_path / "redkitchen_test.txt", truth, "pgt", cameras)
    write_pose_file(tmp_path / "redkitchen_as.txt", estimates, "hloc")
    paths = tmp_path / "redkitchen_as.txt", tmp_path / "redkitchen_test.txt"
    errors = protocol_errors(*paths)
    data = evaluated(capsys, *paths)
    assert (data["queries"], data["localized"], data["not_in_truth"]) == (60, 58, 1)
    finite = errors[np.isfinite(errors[:, 0])]
    assert finite[:, 1].max() > 170.0
    centimetres, degrees = np.median(finite, axis=0)
    assert data["median_position_m"] == pytest.approx(centimetres / 100, abs=1e-9)
    assert data["median_rotation_degrees"] == pytest.approx(degrees, abs=1e-6)
    recall = np.mean(errors.max(axis=1) < 5.0)
    assert 0.1 < recall < 0.9
    assert data["within"][1] == {
        "position_m": 0.05,
        "rotation_degrees": 5.0,
        "share": pytest.approx(recall),
    }


@pytest.mark.parametrize("estimated", ["hloc", "colmap", "json", "tum"])
@pytest.mark.parametrize("known", ["pgt", "colmap", "json"])
def test_forms_make_no_difference(
    estimated: PoseFormat,
    known: PoseFormat,
    truth: Poses,
    estimates: Poses,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    estimates = {name: pose for name, pose in estimates.items() if name in truth}
    cameras = dict.fromkeys(truth, simple_camera())
    write_pose_file(tmp_path / "a.txt", estimates, "hloc")
    write_pose_file(tmp_path / "b.txt", truth, "hloc")
    expected = evaluated(capsys, tmp_path / "a.txt", tmp_path / "b.txt")
    write_pose_file(tmp_path / "a", estimates, estimated, cameras)
    write_pose_file(tmp_path / "b", truth, known, cameras)
    data = evaluated(capsys, tmp_path / "a", tmp_path / "b")
    assert data.pop("matched_by_position") is (estimated == "tum")
    assert expected.pop("matched_by_position") is False
    for key in ("median_position_m", "median_rotation_degrees"):
        assert data.pop(key) == pytest.approx(expected.pop(key), abs=1e-7)
    assert data == expected


def test_timestamps_on_either_side(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = {f"rgb/{1305031102.175304 + i / 30:.6f}.png": random_pose(rng) for i in range(9)}
    some = dict(list(truth.items())[2:7])
    for name, poses in (("truth", truth), ("some", some)):
        write_pose_file(tmp_path / f"{name}.txt", poses, "hloc")
        write_pose_file(tmp_path / f"{name}.tum", poses, "tum")
    for a in ("some.txt", "some.tum"):
        for b in ("truth.txt", "truth.tum"):
            data = evaluated(capsys, tmp_path / a, tmp_path / b)
            assert (data["queries"], data["localized"], data["not_in_truth"]) == (9, 5, 0)
            assert data["median_position_m"] == pytest.approx(0.0, abs=1e-9)


def test_timestamps_of_other_photos(
    truth: Poses, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_pose_file(tmp_path / "truth.txt", truth, "hloc")
    (tmp_path / "poses.tum").write_text("1305031102.17 0 0 0 0 0 0 1\n")
    assert main(["evaluate", str(tmp_path / "poses.tum"), str(tmp_path / "truth.txt")]) == 2
    assert "timestamps of the TUM file are not the photos' numbers" in capsys.readouterr().err
    # The other way round, positions would be those of the estimates: never tried.
    (tmp_path / "poses.tum").write_text("0 0 0 0 0 0 0 1\n")
    assert main(["evaluate", str(tmp_path / "truth.txt"), str(tmp_path / "poses.tum")]) == 2
    assert main(["evaluate", str(tmp_path / "poses.tum"), str(tmp_path / "truth.txt")]) == 0
    assert "read as positions in the truth list" in capsys.readouterr().err


def test_units(
    truth: Poses, estimates: Poses, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = tmp_path / "a.txt", tmp_path / "b.txt"
    write_pose_file(paths[0], estimates, "hloc")
    write_pose_file(paths[1], truth, "hloc")
    metric = evaluated(capsys, *paths)
    small = evaluated(capsys, *paths, "--metres-per-unit", "0.25")
    assert small["metres_per_unit"] == 0.25
    assert small["median_position_m"] == pytest.approx(
        0.25 * float(str(metric["median_position_m"]))
    )
    assert small["median_rotation_degrees"] == metric["median_rotation_degrees"]
    for bad in ("0", "-1", "nan", "inf"):
        assert main(["evaluate", *map(str, paths), f"--metres-per-unit={bad}"]) == 2
        assert "--metres-per-unit must be positive" in capsys.readouterr().err


def test_poses_that_are_not_finite_are_no_poses(
    truth: Poses, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As programs write them that have none; but the truth must be whole."""
    paths = [tmp_path / "truth.txt", tmp_path / "estimates.txt"]
    for path in paths:
        write_pose_file(path, truth, "hloc")
    lines = paths[1].read_text().splitlines()
    for row, value in ((0, "nan"), (5, "inf")):
        lines[row] = " ".join([lines[row].split()[0], *[value] * 7])
    paths[1].write_text("\n".join(lines) + "\n")
    data = evaluated(capsys, paths[1], paths[0])
    assert data["localized"] == len(truth) - 2
    assert data["not_finite"] == 2
    assert main(["evaluate", str(paths[0]), str(paths[1])]) == 2
    assert "line 1" in capsys.readouterr().err
