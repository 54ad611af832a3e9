# SPDX-License-Identifier: Apache-2.0
"""transforms.json of nerfstudio, instant-ngp and Blender, and of other machines."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import dataset_folders as folders
import numpy as np
import pytest
from dataset_folders import query_names

from gscpe.datasets import (
    read_transforms,
)
from gscpe.errors import DatasetError
from gscpe.geometry import Camera


def test_transforms_split_lists(tmp_path: Path) -> None:
    names = sorted(folders.write_transforms(tmp_path))
    assert query_names(read_transforms(tmp_path)) == names[::8]
    assert query_names(read_transforms(tmp_path / "transforms.json", every=3)) == names[::3]
    train, test = ([f"./{name}" for name in listed] for listed in (names[:5], names[6:]))
    folders.write_transforms(tmp_path, train_filenames=train, test_filenames=test)
    dataset = read_transforms(tmp_path)
    assert query_names(dataset) == names[6:]
    assert list(dataset.references.names) == names[:5]
    assert query_names(read_transforms(tmp_path, every=4)) == names[::4]


def test_blender_folder(tmp_path: Path) -> None:
    """Split by file, names without endings, and a field of view."""
    folders.write_transforms(tmp_path, camera={"camera_angle_x": 0.9})
    tree = json.loads((tmp_path / "transforms.json").read_text())
    for frame in tree["frames"]:
        frame["file_path"] = frame["file_path"].removesuffix(".png")
    for split, part in (("train", tree["frames"][:6]), ("test", tree["frames"][6:])):
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps({**tree, "frames": part}))
    (tmp_path / "transforms.json").unlink()
    dataset = read_transforms(tmp_path)
    assert query_names(dataset) == ["images/frame_00007.png", "images/frame_00008.png"]
    assert len(dataset.references) == 6
    assert dataset.queries[0].camera.cx == 32.0


def test_transforms_beside_the_photos(tmp_path: Path) -> None:
    """Paths may lead out of the folder; values of a frame come before those of the file."""
    folders.write_transforms(tmp_path)
    tree = json.loads((tmp_path / "transforms.json").read_text())
    (tmp_path / "run").mkdir()
    for frame in tree["frames"]:
        frame["file_path"] = "../" + frame["file_path"]
    tree["frames"][0]["fl_x"] = 77.0
    (tmp_path / "run/transforms.json").write_text(json.dumps(tree))
    dataset = read_transforms(tmp_path / "run")
    assert dataset.image_folder == tmp_path
    assert dataset.queries[0].name == "images/frame_00001.png"
    assert dataset.queries[0].camera.fx == 77.0
    assert dataset.references.cameras[0].fx == 60.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_model": "OPENCV_FISHEYE"}, "OPENCV_FISHEYE is not supported"),
        ({"is_fisheye": True}, "fisheye is not supported"),
        ({"k4": 0.1}, "k4 is not supported"),
        ({"fl_x": "wide"}, "fl_x is not a number"),
        ({"fl_x": float("nan")}, "finite"),
        ({"w": 0}, "not a possible image size"),
        ({"w": 128, "h": 96}, "is 64x48, but its camera is 128x96"),
    ],
)
def test_transforms_cameras_that_are_refused(
    change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    folders.write_transforms(tmp_path, None, {**folders.TRANSFORMS_CAMERA, **change})
    with pytest.raises(DatasetError, match=message):
        read_transforms(tmp_path)


def changed_transforms(folder: Path, **extra: Any) -> tuple[dict[str, Any], Path]:
    folders.write_transforms(folder, **extra)
    path = folder / "transforms.json"
    return json.loads(path.read_text()), path


def test_transforms_of_windows(tmp_path: Path) -> None:
    """Backslashes in paths, lists of the split too; UTF-16 with a mark."""
    tree, path = changed_transforms(tmp_path, test_filenames=["images\\frame_00003.png"])
    for frame in tree["frames"]:
        frame["file_path"] = frame["file_path"].removeprefix("./").replace("/", "\\")
    path.write_text(json.dumps(tree), encoding="utf-16")
    dataset = read_transforms(tmp_path)
    assert query_names(dataset) == ["images/frame_00003.png"]
    assert len(dataset.references) == 7


def test_transforms_of_three_rows(tmp_path: Path) -> None:
    tree, path = changed_transforms(tmp_path)
    expected = read_transforms(tmp_path)
    for frame in tree["frames"]:
        del frame["transform_matrix"][3]
    path.write_text(json.dumps(tree))
    found = read_transforms(tmp_path)
    np.testing.assert_array_equal(
        found.references.cam_from_world, expected.references.cam_from_world
    )


@pytest.mark.parametrize("value", [float("nan"), None, "lost"])
def test_transforms_with_lost_frames(
    value: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Left out, with one warning that counts them; an error where nothing is left."""
    tree, path = changed_transforms(tmp_path)
    for frame in tree["frames"][2:4]:
        frame["transform_matrix"][1][3] = value
    path.write_text(json.dumps(tree))
    dataset = read_transforms(tmp_path)
    assert len(dataset.references) + len(dataset.queries) == 6
    assert set(dataset.truths["transforms"]).isdisjoint(
        ["images/frame_00003.png", "images/frame_00004.png"]
    )
    (warning,) = caplog.messages
    assert "2 of 8 photos have no usable pose" in warning
    for frame in tree["frames"]:
        frame["transform_matrix"][1][3] = value
    path.write_text(json.dumps(tree))
    with pytest.raises(DatasetError, match=r"frame 0 .*not a 4x4 matrix of finite numbers"):
        read_transforms(tmp_path)


def test_transforms_of_portraits_and_landscapes(tmp_path: Path) -> None:
    """Without w and h each photo has its own size, and its own focal length of one angle."""
    folders.write_transforms(tmp_path, camera={"camera_angle_x": 2 * np.arctan(0.5)})
    folders.write_photo(tmp_path / "images/frame_00004.png", (48, 64))
    dataset = read_transforms(tmp_path)
    cameras = dict(zip(dataset.references.names, dataset.references.cameras, strict=True))
    portrait = Camera.pinhole(48, 64, fx=48, fy=48, cx=24, cy=32)
    landscape = Camera.pinhole(64, 48, fx=64, fy=64, cx=32, cy=24)
    for name, camera in cameras.items():
        expected = portrait if name == "images/frame_00004.png" else landscape
        assert (camera.width, camera.height) == (expected.width, expected.height)
        np.testing.assert_allclose(camera.matrix(), expected.matrix(), atol=1e-9)
