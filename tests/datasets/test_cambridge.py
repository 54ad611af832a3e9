# SPDX-License-Identifier: Apache-2.0
"""Cambridge Landmarks: its split, and where the intrinsics come from."""

from __future__ import annotations

import logging
from pathlib import Path

import dataset_folders as folders
import pytest
from dataset_folders import college, query_names
from scenes import write_colmap_model

from gscpe.geometry import Camera


def test_cambridge_split_and_subset(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folders.write_cambridge(tmp_path)
    (tmp_path / "KingsCollege/seq1/frame00001.png").unlink()
    photo = tmp_path / "KingsCollege/seq2/frame00005.png"
    folders.write_photo(photo.with_suffix(".jpg"))
    photo.unlink()
    with caplog.at_level(logging.WARNING):
        dataset = college(tmp_path)
    assert dataset.references.names == tuple(f"seq1/frame0000{i}.png" for i in (2, 3, 4))
    assert query_names(dataset)[0] == "seq2/frame00005.jpg"
    assert len(dataset.queries) == 4
    assert "1 of 8 photos" in caplog.text


@pytest.mark.parametrize(
    "folder",
    [
        "KingsCollege/sparse/0",
        "KingsCollege/sparse",
        "CambridgeLandmarks_Colmap_Retriangulated_1024px/KingsCollege/empty_all",
    ],
)
def test_cambridge_intrinsics_of_a_colmap_model(folder: str, tmp_path: Path) -> None:
    """Of scaled photos, as hloc's: the camera is scaled up to the photo."""
    poses = folders.write_cambridge(tmp_path)
    (tmp_path / "KingsCollege/reconstruction.nvm").unlink()
    half = Camera.parse("SIMPLE_RADIAL 32 24 27.5 16 12 -0.05")
    write_colmap_model(tmp_path / folder, half, poses)
    dataset = college(tmp_path)
    for camera in (*dataset.references.cameras, *(query.camera for query in dataset.queries)):
        assert camera == Camera.parse("SIMPLE_RADIAL 64 48 55 32 24 -0.05")


def test_cambridge_train_and_test_models(tmp_path: Path) -> None:
    poses = folders.write_cambridge(tmp_path)
    (tmp_path / "KingsCollege/reconstruction.nvm").unlink()
    camera = Camera.parse("PINHOLE 64 48 55 55 32 24")
    for split, sequence in (("train", "seq1"), ("test", "seq2")):
        part = {name: pose for name, pose in poses.items() if name.startswith(sequence)}
        write_colmap_model(tmp_path / f"KingsCollege/model_{split}", camera, part)
    assert college(tmp_path).queries[0].camera == camera
