# SPDX-License-Identifier: Apache-2.0
"""A known point falls on the same pixel through every reader's camera and pose."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

import cv2
import dataset_folders as folders
import numpy as np
import pytest
from helpers import distorted_projection
from numpy.typing import NDArray

from gscpe.datasets import (
    Dataset,
    read_cambridge,
    read_colmap,
    read_fast_livo2,
    read_rgbd_folder,
    read_seven_scenes,
    read_transforms,
)
from gscpe.datasets.nvm import nvm_camera
from gscpe.geometry import Camera, se3
from gscpe.geometry.projection import transform_points

# In front of the camera, over all of the image.
IN_CAM = np.array([[x, y, 1.0] for x in (-0.5, 0.0, 0.45) for y in (-0.35, 0.3)]) * 3.0


def rays(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points[:, :2] / points[:, 2:]


def nvm_pixels(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solves the ideal = (1 + radial |m|^2) m of VisualSFM for m."""
    ideal = np.linalg.norm(rays(points), axis=1)
    roots = [np.roots([folders.NVM_RADIAL, 0.0, 1.0, -r]) for r in ideal]
    measured = np.array([min(r.real[(abs(r.imag) < 1e-9) & (r.real >= 0)]) for r in roots])
    scale = np.divide(measured, ideal, out=np.ones_like(ideal), where=ideal > 0)
    return np.asarray(folders.NVM_FOCAL * rays(points) * scale[:, None] + [32.0, 24.0])


def livo_pixels(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """OpenCV at full size, then its pixel centres at 0.5, then half the size."""
    c = folders.LIVO_CAMERA
    matrix = np.array([[c["cam_fx"], 0, c["cam_cx"]], [0, c["cam_fy"], c["cam_cy"]], [0, 0, 1]])
    lens = np.array([c[f"cam_d{i}"] for i in range(4)], dtype=float)
    zero = np.zeros(3)
    pixels = cv2.projectPoints(points, zero, zero, matrix.astype(float), lens)[0][:, 0]
    return np.asarray((pixels + 0.5) / 2.0)


def opencv_pixels(points: NDArray[np.float64]) -> NDArray[np.float64]:
    camera = Camera.parse(folders.RGBD_CAMERA)
    return distorted_projection(camera, points)


def pinhole_pixels(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return 52.75 * rays(points) + [32.0, 24.0]


def rgbd_writer(form: str) -> Callable[[Path], folders.Poses]:
    return lambda root: folders.write_rgbd_folder(root, form=form)


Case = tuple[
    Callable[[Path], folders.Poses],
    Callable[[Path], Dataset],
    Callable[[NDArray[np.float64]], NDArray[np.float64]],
    float,
]
"""Writes it, reads it, where points lie in its photos, and to how many pixels."""

CASES: dict[str, Case] = {
    "7-Scenes": (
        folders.write_seven_scenes,
        lambda root: read_seven_scenes(root, "redkitchen"),
        pinhole_pixels,
        1e-6,
    ),
    "7-Scenes, original": (
        folders.write_seven_scenes,
        lambda root: read_seven_scenes(root, "redkitchen", "original"),
        pinhole_pixels,
        1e-5,
    ),
    "Cambridge": (
        folders.write_cambridge,
        lambda root: read_cambridge(root, "KingsCollege"),
        nvm_pixels,
        1e-3,
    ),
    "FAST-LIVO2": (
        folders.write_fast_livo2,
        lambda root: read_fast_livo2(root, "CBD_Building_01"),
        livo_pixels,
        1e-6,
    ),
    "FAST-LIVO2, trajectory of the camera": (
        lambda root: folders.write_fast_livo2(root, extrinsics=False),
        lambda root: read_fast_livo2(root, "CBD_Building_01"),
        livo_pixels,
        1e-6,
    ),
    "nerfstudio": (folders.write_transforms, read_transforms, opencv_pixels, 1e-6),
    "RGB-D, matrices": (rgbd_writer("matrices"), read_rgbd_folder, opencv_pixels, 1e-5),
    "RGB-D, stamps": (rgbd_writer("stamps"), read_rgbd_folder, opencv_pixels, 1e-6),
    "RGB-D, order": (rgbd_writer("order"), read_rgbd_folder, opencv_pixels, 1e-6),
}


def check(
    dataset: Dataset,
    poses: folders.Poses,
    pixels: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    atol: float,
) -> None:
    """Both halves of the data set, and its truth, put known points on the right pixels."""
    found = {
        name: (camera, pose)
        for name, camera, pose in zip(
            dataset.references.names,
            dataset.references.cameras,
            dataset.references.cam_from_world,
            strict=True,
        )
    }
    truth = next(iter(dataset.truths.values()))
    found |= {query.name: (query.camera, truth[query.name]) for query in dataset.queries}
    assert found.keys() == poses.keys() == truth.keys()
    for name, (camera, pose) in found.items():
        assert (dataset.image_folder / name).is_file()
        world = transform_points(se3.inverse(poses[name]), IN_CAM)
        projected = distorted_projection(camera, transform_points(pose, world))
        np.testing.assert_allclose(projected, pixels(IN_CAM), atol=atol)


@pytest.mark.parametrize("case", CASES)
def test_points_project_alike(case: str, tmp_path: Path) -> None:
    write, read, pixels, atol = CASES[case]
    poses = write(tmp_path)
    check(read(tmp_path), poses, pixels, atol)


def test_colmap(tmp_path: Path) -> None:
    from scenes import write_colmap_model

    camera = Camera.parse(folders.RGBD_CAMERA)
    poses = {f"{i}.png": pose for i, pose in enumerate(folders.some_poses())}
    for name in poses:
        folders.write_photo(tmp_path / "images" / name)
    write_colmap_model(tmp_path / "sparse", camera, poses)
    dataset = read_colmap(tmp_path / "sparse", tmp_path / "images")
    check(dataset, poses, opencv_pixels, 1e-6)


def test_a_blender_field_of_view_is_a_focal_length(tmp_path: Path) -> None:
    angle = 2 * np.arctan(32 / 52.75)
    poses = folders.write_transforms(tmp_path, camera={"camera_angle_x": angle})
    check(read_transforms(tmp_path), poses, pinhole_pixels, 1e-6)


@pytest.mark.parametrize("radial", [-0.25, -0.05, 0.05, 0.2, 0.4])
def test_visualsfm_distortion_is_inverted(radial: float) -> None:
    """Through the definition of either side, over the whole photo, to 0.02 px and better."""
    camera = nvm_camera(1920, 1080, 1670.0, radial)
    u, v = np.meshgrid(np.linspace(0, 1920, 33), np.linspace(0, 1080, 19))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    measured = (pixels - [960, 540]) / 1670.0
    ideal = measured * (1.0 + radial * np.sum(measured**2, axis=1, keepdims=True))
    points = np.column_stack([ideal, np.ones(len(ideal))])
    error = np.linalg.norm(distorted_projection(camera, points) - pixels, axis=1)
    assert error.max() < 1e-3
    # The test is able to fail: the sign and the direction matter.
    assert np.abs(ideal - measured).max() * 1670.0 > 10.0
