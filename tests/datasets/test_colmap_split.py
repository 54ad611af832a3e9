# SPDX-License-Identifier: Apache-2.0
"""COLMAP models as data sets: which photos are queries, and their sizes."""

from __future__ import annotations

from pathlib import Path

import dataset_folders as folders
import numpy as np
import pytest
from dataset_folders import query_names
from scenes import write_colmap_model

from gscpe.datasets import (
    read_colmap,
)
from gscpe.errors import ColmapModelError, DatasetError, SettingsError
from gscpe.geometry import Camera
from gscpe.poses.hloc import format_pose
from gscpe.scene.query_list import Query


@pytest.fixture
def model(tmp_path: Path) -> Path:
    poses = {f"{i:02d}.png": pose for i, pose in enumerate(folders.some_poses(17))}
    for name in poses:
        folders.write_photo(tmp_path / "images" / name)
    write_colmap_model(tmp_path / "sparse", Camera.parse("PINHOLE 64 48 55 55 32 24"), poses)
    return tmp_path


def test_colmap_every_nth(model: Path) -> None:
    dataset = read_colmap(model / "sparse", model / "images")
    assert query_names(dataset) == ["00.png", "08.png", "16.png"]
    assert dataset.metres_per_unit is None
    assert dataset.scene == model.name
    third = read_colmap(model / "sparse", model / "images", every=3, metres_per_unit=0.5)
    assert query_names(third) == [f"{i:02d}.png" for i in range(0, 17, 3)]
    assert third.metres_per_unit == 0.5


def test_colmap_test_list(model: Path) -> None:
    (model / "test.txt").write_text("# test\n03.png\n\n11.png\nunregistered.png\n")
    dataset = read_colmap(model / "sparse", model / "images", test_list=model / "test.txt")
    assert query_names(dataset) == ["03.png", "11.png"]
    assert len(dataset.references) == 15
    (model / "test.txt").write_text("elsewhere.png\n")
    with pytest.raises(DatasetError, match=r"test\.txt: no photo of"):
        read_colmap(model / "sparse", model / "images", test_list=model / "test.txt")


def test_colmap_with_a_query_list(model: Path) -> None:
    (true,) = folders.some_poses(1, seed=5)
    folders.write_photo(model / "queries/night/a.png")
    (model / "queries.txt").write_text(
        "night/a.png PINHOLE 64 48 50 50 32 24\nlost.png PINHOLE 64 48 50 50 32 24\n"
    )
    (model / "truth.txt").write_text(f"night/a.png {format_pose(true)}\n")
    queries, truths, folder = model / "queries.txt", model / "truth.txt", model / "queries"
    dataset = read_colmap(
        model / "sparse", model / "images", queries=queries, truth=truths, query_folder=folder
    )
    assert dataset.image_folder == model / "images"
    assert dataset.query_folder == folder
    assert query_names(dataset) == ["night/a.png"]  # as in the lists
    assert dataset.references.names[0] == "00.png"
    assert len(dataset.references) == 17
    assert dataset.queries[0].camera.fx == 50
    truth = dataset.truths["colmap"]["night/a.png"]
    np.testing.assert_allclose(truth, true, atol=1e-8)
    with pytest.raises(SettingsError, match="belong together"):
        read_colmap(model / "sparse", model / "images", queries=queries)
    with pytest.raises(SettingsError, match="not several"):
        read_colmap(model / "sparse", model / "images", every=3, test_list=model / "truth.txt")


def test_a_photo_of_another_size_is_refused(model: Path) -> None:
    """Whichever it is, with its name."""
    folders.write_photo(model / "images/05.png", (32, 24))
    with pytest.raises(ColmapModelError, match=r"05\.png is 32x24, but its camera is 64x48"):
        read_colmap(model / "sparse", model / "images", every=2)


def test_queries_of_half_the_size(model: Path) -> None:
    """Those of a list, in a folder of their own, beside references of the model's size."""
    folders.write_photo(model / "queries/my night.png", (32, 24))
    (model / "queries.txt").write_text("my night.png PINHOLE 64 48 50 50 32 24\n")
    (model / "truth.txt").write_text("my night.png 1 0 0 0 0 0 1\n")
    dataset = read_colmap(
        model / "sparse",
        model / "images",
        queries=model / "queries.txt",
        truth=model / "truth.txt",
        query_folder=model / "queries",
    )
    (query,) = dataset.queries
    assert query == Query("my night.png", Camera.pinhole(32, 24, fx=25, fy=25, cx=16, cy=12))
    assert dataset.references.cameras[0].width == 64
