# SPDX-License-Identifier: Apache-2.0
"""Every missing file of a data set is named, with where it comes from."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any, Callable

import dataset_folders as folders
import pytest
from dataset_folders import building, college, kitchen

from gscpe.datasets import (
    Dataset,
    read_rgbd_folder,
    read_transforms,
)
from gscpe.errors import DatasetError, MissingDependencyError


@pytest.mark.parametrize(
    ("write", "read", "lost", "source"),
    [
        (folders.write_seven_scenes, kitchen, "redkitchen", "microsoft.com"),
        (folders.write_seven_scenes, kitchen, "redkitchen/TrainSplit.txt", "microsoft.com"),
        (folders.write_seven_scenes, kitchen, "redkitchen/TestSplit.txt", "microsoft.com"),
        (folders.write_seven_scenes, kitchen, "redkitchen/seq-03", "microsoft.com"),
        (folders.write_seven_scenes, kitchen, "pgt/sfm/7scenes/redkitchen_train.txt", "tsattler"),
        (folders.write_seven_scenes, kitchen, "pgt/sfm/7scenes/redkitchen_test.txt", "tsattler"),
        (folders.write_cambridge, college, "KingsCollege", "cam.ac.uk"),
        (folders.write_cambridge, college, "KingsCollege/dataset_train.txt", "cam.ac.uk"),
        (folders.write_cambridge, college, "KingsCollege/dataset_test.txt", "cam.ac.uk"),
        (folders.write_cambridge, college, "KingsCollege/reconstruction.nvm", "cam.ac.uk"),
        (folders.write_fast_livo2, building, "CBD_Building_01/images", "hku-mars"),
        (folders.write_fast_livo2, building, "CBD_Building_01/trajectory.txt", "hku-mars"),
        (folders.write_fast_livo2, building, "CBD_Building_01/camera_pinhole.yaml", "hku-mars"),
        (folders.write_transforms, read_transforms, "transforms.json", "ns-process-data"),
        (folders.write_transforms, read_transforms, "images", "transforms.json"),
        (folders.write_rgbd_folder, read_rgbd_folder, "rgb", "docs/datasets.md"),
        (folders.write_rgbd_folder, read_rgbd_folder, "camera.txt", "docs/datasets.md"),
        (folders.write_rgbd_folder, read_rgbd_folder, "poses", "trajectory.txt"),
    ],
)
def test_a_missing_file_is_named_with_its_source(
    write: Callable[[Path], Any],
    read: Callable[[Path], Dataset],
    lost: str,
    source: str,
    tmp_path: Path,
) -> None:
    write(tmp_path)
    read(tmp_path)
    path = tmp_path / lost
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(DatasetError) as caught:
        read(tmp_path)
    assert str(path) in str(caught.value)
    assert source in str(caught.value)


def test_missing_yaml_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders.write_fast_livo2(tmp_path)
    monkeypatch.setitem(sys.modules, "yaml", None)
    with pytest.raises(MissingDependencyError, match=r"gscpe\[datasets\]"):
        building(tmp_path)
