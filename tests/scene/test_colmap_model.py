# SPDX-License-Identifier: Apache-2.0
"""COLMAP models as they come: unused cameras, smaller photos, blanks, rigs, no points, damage."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray

from gscpe.errors import CameraError, ColmapModelError
from gscpe.geometry import Camera
from gscpe.photos import write_image
from gscpe.poses import write_colmap_folder
from gscpe.poses.hloc import format_pose
from gscpe.scene.colmap_model import read_colmap_references

Poses = dict[str, NDArray[np.float64]]

CAMERA = Camera.pinhole(64, 48, fx=60, fy=61, cx=31, cy=25)
OTHER = Camera.from_colmap("OPENCV", 48, 64, [70, 70, 24, 32, 0.1, 0, 0.01, 0])


@pytest.fixture
def poses(rng: np.random.Generator) -> Poses:
    return {name: random_pose(rng) for name in ("a.png", "my b.png", "sub/c d 1.png")}


def write_photos(folder: Path, sizes: dict[str, tuple[int, int]]) -> Path:
    for name, (width, height) in sizes.items():
        write_image(folder / name, np.zeros((height, width, 3), np.uint8))
    return folder


def write_text_model(folder: Path, poses: Poses, cameras: str = CAMERA.colmap_text()) -> Path:
    """Photos of camera 1, with some points; no points3D."""
    folder.mkdir()
    (folder / "cameras.txt").write_text(f"# cameras\n1 {cameras}\n")
    lines = [f"{i} {format_pose(pose)} 1 {name}\n" for i, (name, pose) in enumerate(poses.items())]
    points = ["1.5 2.5 -1 3 4 17\n", "\n", "7 8 9\n"]
    pairs = zip(lines, points, strict=True)
    (folder / "images.txt").write_text("# images\n" + "".join(a + b for a, b in pairs))
    return folder


def check(model: Path, images: Path, poses: Poses) -> tuple[Camera, ...]:
    found = read_colmap_references(model, images)
    assert found.names == tuple(sorted(poses))
    for name, pose in zip(found.names, found.cam_from_world, strict=True):
        np.testing.assert_allclose(pose, poses[name], atol=2e-9)
    return found.cameras


@pytest.mark.parametrize("binary", [False, True])
def test_names_with_blanks_and_no_points(binary: bool, poses: Poses, tmp_path: Path) -> None:
    images = write_photos(tmp_path / "images", dict.fromkeys(poses, (64, 48)))
    model = tmp_path / "model"
    if binary:
        write_colmap_folder(model, poses, dict.fromkeys(poses, CAMERA))
        (model / "points3D.bin").unlink()
    else:
        write_text_model(model, poses)
    assert check(model, images, poses) == (CAMERA,) * 3


@pytest.mark.parametrize(
    "model",
    [
        "PINHOLE 64 48 60 61 31 25",
        "SIMPLE_RADIAL 64 48 60 31 25 0.1",
        "OPENCV 64 48 60 61 31 25 0.1 0.02 0.003 0.004",
        "FULL_OPENCV 64 48 60 61 31 25 0.1 0.02 0.003 0.004 0.05 0.01 0.02 0.03",
        "OPENCV_FISHEYE 64 48 60 61 31 25 0.1 0.02 0.003 0.004",
        "THIN_PRISM_FISHEYE 64 48 60 61 31 25 0.1 0.02 0.003 0.004 0.05 0.06 0.001 0.002",
    ],
)
def test_every_camera_can_be_written_and_read_again(
    model: str, poses: Poses, tmp_path: Path
) -> None:
    camera = Camera.parse(model.replace(" ", ","))
    images = write_photos(tmp_path / "images", dict.fromkeys(poses, (64, 48)))
    write_colmap_folder(tmp_path / "model", poses, dict.fromkeys(poses, camera))
    assert check(tmp_path / "model", images, poses) == (camera,) * 3


def test_backslashes_in_names(poses: Poses, tmp_path: Path) -> None:
    images = write_photos(tmp_path / "images", dict.fromkeys(poses, (64, 48)))
    windows = {name.replace("/", "\\"): pose for name, pose in poses.items()}
    check(write_text_model(tmp_path / "model", windows), images, poses)


def test_cameras_of_no_photo_do_not_count(poses: Poses, tmp_path: Path) -> None:
    images = write_photos(tmp_path / "images", dict.fromkeys(poses, (64, 48)))
    fisheye = "OPENCV_FISHEYE 64 48 60 61 31 25 0 0 0 0"
    model = write_text_model(
        tmp_path / "model", poses, f"{CAMERA.colmap_text()}\n2 {fisheye}\n3 NEW 1 1"
    )
    assert check(model, images, poses) == (CAMERA,) * 3
    (model / "cameras.txt").write_text(f"1 {fisheye}\n")
    if "OPENCV_FISHEYE" not in _supported():
        with pytest.raises(CameraError, match=r"model, a\.png: .*OPENCV_FISHEYE"):
            read_colmap_references(model, images)
    (model / "cameras.txt").write_text("2 NEW 1 1\n")
    with pytest.raises(ColmapModelError, match=r"no camera of a\.png, 1"):
        read_colmap_references(model, images)


def _supported() -> set[str]:
    try:
        Camera.from_colmap("OPENCV_FISHEYE", 64, 48, [60, 61, 31, 25, 0, 0, 0, 0])
    except CameraError:
        return set()
    return {"OPENCV_FISHEYE"}


@pytest.mark.parametrize("factor", [2, 4, 8, 0.5, 3])
def test_smaller_photos_have_scaled_cameras(
    factor: float, poses: Poses, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A pixel means the same ray; portraits and landscapes, distortion too."""
    cameras = dict(zip(poses, (CAMERA, OTHER, CAMERA), strict=True))
    write_colmap_folder(tmp_path / "model", poses, cameras)
    sizes = {n: (int(c.width / factor), int(c.height / factor)) for n, c in cameras.items()}
    images = write_photos(tmp_path / "images", sizes)
    for camera, (name, whole) in zip(
        check(tmp_path / "model", images, poses), cameras.items(), strict=True
    ):
        assert (camera.width, camera.height) == sizes[name]
        scale = np.diag([camera.width / whole.width, camera.height / whole.height, 1.0])
        np.testing.assert_allclose(camera.matrix(), scale @ whole.matrix(), rtol=1e-12)
        assert camera.distortion == whole.distortion
    (warning,) = caplog.messages
    assert "the cameras are scaled" in warning


@pytest.mark.parametrize(
    ("sizes", "why"),
    [
        ([(32, 24), (64, 48), (64, 48)], r"a\.png is 32x24.* but others are not"),
        ([(64, 48), (64, 48), (32, 24)], r"c d 1\.png is 32x24.* but others are not"),
        ([(32, 24), (16, 12), (32, 24)], r"my b\.png is 16x12.* but others are not"),
        ([(48, 64), (48, 64), (48, 64)], r"a\.png is 48x64.* turned by 90 degrees"),
        ([(64, 48), (64, 40), (64, 48)], r"my b\.png is 64x40.* cropped, or from another camera"),
        ([(64, 47), (64, 47), (64, 47)], r"a\.png is 64x47.* cropped, or from another camera"),
        ([(32, 20), (32, 20), (32, 20)], r"a\.png is 32x20.* cropped, or from another camera"),
    ],
)
def test_sizes_that_do_not_fit_are_named(
    sizes: list[tuple[int, int]], why: str, poses: Poses, tmp_path: Path
) -> None:
    """Photo, folder, model, and both sizes."""
    model = write_text_model(tmp_path / "model", poses)
    images = write_photos(tmp_path / "images", dict(zip(poses, sizes, strict=True)))
    with pytest.raises(ColmapModelError, match=why) as caught:
        read_colmap_references(model, images)
    for words in (str(images), str(model), "its camera is 64x48"):
        assert words in str(caught.value)


@pytest.mark.parametrize("text", [False, True])
def test_rigs(text: bool, tmp_path: Path) -> None:
    """COLMAP 3.12 and later keep poses of frames; one of these has none."""
    pycolmap = pytest.importorskip("pycolmap")
    options = pycolmap.SyntheticDatasetOptions()
    if not hasattr(options, "num_rigs"):
        pytest.skip("a pycolmap without rigs")
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 2, 3
    options.num_points3D = 20
    model = pycolmap.synthesize_dataset(options)
    model.deregister_frame(next(iter(model.frames)))
    for image in model.images.values():
        image.name = image.name.replace("_", " ")
    folder = tmp_path / "model"
    folder.mkdir()
    (model.write_text if text else model.write_binary)(str(folder))
    assert (folder / f"frames.{'txt' if text else 'bin'}").is_file()
    theirs = {i.name: i.cam_from_world().matrix() for i in model.images.values() if i.has_pose}
    assert len(theirs) == 4
    whole = {name: np.vstack([pose, (0, 0, 0, 1)]) for name, pose in theirs.items()}
    images = write_photos(tmp_path / "images", dict.fromkeys(whole, (1024, 768)))
    assert {camera.fx for camera in check(folder, images, whole)} == {1280.0}


def test_damaged_binaries_are_named(poses: Poses, tmp_path: Path) -> None:
    whole = tmp_path / "whole"
    write_colmap_folder(whole, poses, dict.fromkeys(poses, OTHER))
    for name in ("cameras.bin", "images.bin"):
        data = (whole / name).read_bytes()
        for length in range(0, len(data), 5):
            shutil.copytree(whole, tmp_path / "cut", dirs_exist_ok=True)
            (tmp_path / "cut" / name).write_bytes(data[:length])
            with pytest.raises(ColmapModelError, match=rf"{name} is damaged"):
                read_colmap_references(tmp_path / "cut", tmp_path)
    (whole / "images.bin").unlink()
    with pytest.raises(ColmapModelError, match="not a complete COLMAP model"):
        read_colmap_references(whole, tmp_path)
