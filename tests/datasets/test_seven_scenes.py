# SPDX-License-Identifier: Apache-2.0
"""7-Scenes: its split, its copies, and where its pseudo ground truth may lie."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import dataset_folders as folders
import numpy as np
import pytest
from dataset_folders import kitchen, query_names

from gscpe.datasets import (
    read_seven_scenes,
)
from gscpe.datasets.dataset import OFFICIAL
from gscpe.errors import DatasetError, SettingsError
from gscpe.geometry import Camera


def test_seven_scenes_split_and_truths(tmp_path: Path) -> None:
    true, slam = folders.some_poses(), folders.some_poses(seed=4)
    poses = folders.write_seven_scenes(tmp_path, true, original=slam)
    sfm = kitchen(tmp_path)
    assert all(name.startswith("seq-01/") for name in sfm.references.names)
    assert all(name.startswith("seq-03/") for name in query_names(sfm))
    assert list(sfm.truths) == ["sfm", "original"]
    original = read_seven_scenes(tmp_path, "redkitchen", "original")
    assert list(original.truths) == ["original", "sfm"]
    for dataset in (sfm, original):
        for i, name in enumerate(sorted(poses)):
            np.testing.assert_allclose(dataset.truths["sfm"][name], poses[name], atol=1e-9)
            np.testing.assert_allclose(dataset.truths["original"][name], slam[i], atol=1e-6)
    first = original.truths["original"][original.references.names[0]]
    np.testing.assert_array_equal(original.references.cam_from_world[0], first)


def test_seven_scenes_is_official_only_when_it_is_whole(tmp_path: Path) -> None:
    folders.write_seven_scenes(tmp_path)
    assert kitchen(tmp_path).split == OFFICIAL
    photos = sorted((tmp_path / "redkitchen").glob("seq-*/frame-*.color.png"))
    photos[0].unlink()
    assert kitchen(tmp_path).split == f"{OFFICIAL}, incomplete"


def test_seven_scenes_without_pseudo_ground_truth(tmp_path: Path) -> None:
    folders.write_seven_scenes(tmp_path)
    shutil.rmtree(tmp_path / "pgt")
    dataset = read_seven_scenes(tmp_path, "redkitchen", "original")
    assert list(dataset.truths) == ["original"]
    assert dataset.queries[0].camera == Camera.pinhole(64, 48, fx=525, fy=525, cx=32, cy=24)


@pytest.mark.parametrize("place", ["redkitchen", "."])
def test_seven_scenes_pseudo_ground_truth_in_other_places(place: str, tmp_path: Path) -> None:
    folders.write_seven_scenes(tmp_path, pgt=place)
    assert list(kitchen(tmp_path).truths) == ["sfm", "original"]
    with pytest.raises(DatasetError, match="elsewhere"):
        read_seven_scenes(tmp_path, "redkitchen", pgt_folder=tmp_path / "elsewhere")
    with pytest.raises(SettingsError):
        read_seven_scenes(tmp_path, "redkitchen", "slam")  # type: ignore[arg-type]


def test_seven_scenes_subset_of_jpg_copies(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Photos on disk count; poses that are damaged or not finite are left out, with one line."""
    poses = folders.write_seven_scenes(tmp_path, ending=".jpg")
    folder = tmp_path / "redkitchen"
    (folder / "seq-01/frame-000000.color.jpg").unlink()
    (folder / "TrainSplit.txt").write_text("sequence1\r\nsequence2\r\n")
    (folder / "seq-01/frame-000001.pose.txt").write_text("1 0 0")
    (folder / "seq-03/frame-000002.pose.txt").write_text("-1.#IND " * 16)
    (folder / "seq-03/frame-000003.pose.txt").write_text(" ".join(["nan"] * 16))
    with caplog.at_level(logging.WARNING):
        sfm = kitchen(tmp_path)
    assert set(sfm.references.names) | set(query_names(sfm)) == set(poses) - {
        "seq-01/frame-000000.color.jpg"
    }
    assert "seq-02" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="gscpe.datasets.assembly"):
        original = read_seven_scenes(tmp_path, "redkitchen", "original")
    assert len(original.references) == 2
    assert query_names(original) == [f"seq-03/frame-00000{i}.color.jpg" for i in (0, 1)]
    records = [r for r in caplog.records if r.name == "gscpe.datasets.assembly"]
    assert len(records) == 1
    assert "3 of 7 photos" in records[0].getMessage()


def test_seven_scenes_still_zipped(tmp_path: Path) -> None:
    folders.write_seven_scenes(tmp_path)
    shutil.rmtree(tmp_path / "redkitchen/seq-01")
    (tmp_path / "redkitchen/seq-01.zip").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"unpack seq-01\.zip"):
        kitchen(tmp_path)
