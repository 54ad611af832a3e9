# SPDX-License-Identifier: Apache-2.0
"""Folders of RGB-D photos."""

from __future__ import annotations

from pathlib import Path

import dataset_folders as folders
import numpy as np
import pytest
from dataset_folders import query_names

from gscpe.datasets import (
    read_rgbd_folder,
)
from gscpe.errors import DatasetError, SettingsError


def test_rgbd_folder_split_and_lost_frames(tmp_path: Path) -> None:
    names = sorted(folders.write_rgbd_folder(tmp_path))
    assert query_names(read_rgbd_folder(tmp_path)) == names[::8]
    (tmp_path / "poses/000000.txt").write_text("-inf " * 16)
    assert query_names(read_rgbd_folder(tmp_path, every=2)) == names[1::2]
    with pytest.raises(SettingsError, match="2 or more"):
        read_rgbd_folder(tmp_path, every=1)


def test_rgbd_matrices_of_three_rows(tmp_path: Path) -> None:
    folders.write_rgbd_folder(tmp_path)
    expected = read_rgbd_folder(tmp_path)
    for path in (tmp_path / "poses").glob("*.txt"):
        np.savetxt(path, np.loadtxt(path)[:3])
    found = read_rgbd_folder(tmp_path)
    np.testing.assert_allclose(
        found.references.cam_from_world, expected.references.cam_from_world, atol=1e-12
    )


def test_rgbd_order_needs_a_pose_a_photo(tmp_path: Path) -> None:
    names = sorted(folders.write_rgbd_folder(tmp_path, form="order"))
    (tmp_path / "rgb" / names[0]).unlink()
    with pytest.raises(DatasetError, match="has 8 poses, but"):
        read_rgbd_folder(tmp_path)


def test_rgbd_camera_line_of_colmap(tmp_path: Path) -> None:
    folders.write_rgbd_folder(tmp_path)
    camera = read_rgbd_folder(tmp_path).queries[0].camera
    (tmp_path / "camera.txt").write_text(f"# id model ...\n1 {folders.RGBD_CAMERA}\n")
    assert read_rgbd_folder(tmp_path).queries[0].camera == camera
    (tmp_path / "camera.txt").write_text("FOV 1 2 3\n")
    with pytest.raises(DatasetError, match=r"camera\.txt: camera model 'FOV'"):
        read_rgbd_folder(tmp_path)
