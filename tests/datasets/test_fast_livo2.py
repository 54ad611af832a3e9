# SPDX-License-Identifier: Apache-2.0
"""FAST-LIVO2: its split, poses between stamps, and calibrations."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import dataset_folders as folders
import numpy as np
import pytest
from dataset_folders import building, query_names

from gscpe.datasets import (
    read_fast_livo2,
)
from gscpe.errors import DatasetError


def test_fast_livo2_split_is_one_to_three(tmp_path: Path) -> None:
    names = sorted(folders.write_fast_livo2(tmp_path))
    dataset = building(tmp_path)
    assert query_names(dataset) == names[::4]
    assert len(dataset.references) == 3 * len(dataset.queries)


def test_fast_livo2_poses_are_interpolated_near_stamps_only(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A turn at constant speed is met exactly; a gap and the ends are left out."""
    scene = tmp_path / "CBD_Building_01"
    folders.write_fast_livo2(tmp_path, extrinsics=False)
    shutil.rmtree(scene / "images")

    def pose_at(t: float) -> folders.Pose:
        angle, pose = 0.8 * t, np.eye(4)
        pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        pose[:3, 3] = [2.0 * t, -t, 0.5]
        return pose

    stamps = [0.0, 0.1, 0.2, 0.3, 0.55, 0.65, 0.75]
    lines = [folders.tum_line(10 + t, pose_at(t)) for t in stamps]
    folders.write_lines(scene / "trajectory.txt", ["# stamp", *lines[::-1]])
    kept, lost = (0.04, 0.1, 0.19, 0.25, 0.6, 0.7, 0.75), (-0.02, 0.35, 0.5, 0.9)
    for t in (*kept, *lost):
        folders.write_photo(scene / "images" / f"{10 + t:.6f}.png")
    with caplog.at_level(logging.WARNING):
        dataset = building(tmp_path)
    truth = dataset.truths["trajectory"]
    assert sorted(truth) == [f"{10 + t:.6f}.png" for t in kept]
    for t in kept:
        world_from_cam = np.linalg.inv(truth[f"{10 + t:.6f}.png"])
        np.testing.assert_allclose(world_from_cam, pose_at(t), atol=1e-6)
    assert "4 of 11 photos" in caplog.text
    shifted = read_fast_livo2(tmp_path, "CBD_Building_01", time_offset=0.02).truths["trajectory"]
    world_from_cam = np.linalg.inv(shifted["10.040000.png"])
    np.testing.assert_allclose(world_from_cam, pose_at(0.06), atol=1e-6)


def test_fast_livo2_calibrations_in_other_dresses(tmp_path: Path) -> None:
    """OpenCV's first line, and ROS 2's wrapping; a fisheye and another size are refused."""
    folders.write_fast_livo2(tmp_path)
    path = tmp_path / "CBD_Building_01/camera_pinhole.yaml"
    text = path.read_text()
    camera = building(tmp_path).queries[0].camera
    path.write_text("%YAML:1.0\n---\n" + text)
    assert building(tmp_path).queries[0].camera == camera
    inner = "".join(f"      {line}\n" for line in text.replace("cam_", "").splitlines())
    path.write_text("/**:\n  ros__parameters:\n    camera:\n" + inner)
    assert building(tmp_path).queries[0].camera == camera
    path.write_text(text.replace("Pinhole", "EquidistantCamera"))
    with pytest.raises(DatasetError, match="EquidistantCamera"):
        building(tmp_path)
    path.write_text(text.replace("cam_height: 96", "cam_height: 128"))
    with pytest.raises(DatasetError, match="is not a scaled 128x128"):
        building(tmp_path)
