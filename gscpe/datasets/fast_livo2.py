# SPDX-License-Identifier: Apache-2.0
"""FAST-LIVO2 (LiDAR, inertial, visual): its photos, trajectory and calibration.

Zheng et al., "FAST-LIVO2: Fast, Direct LiDAR-Inertial-Visual Odometry", IEEE T-RO 2024;
https://github.com/hku-mars/FAST-LIVO2.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.datasets.assembly import make_dataset
from gscpe.datasets.dataset import Dataset
from gscpe.datasets.files import missing, number_at
from gscpe.datasets.matrix_pose import invert_pose
from gscpe.datasets.photos import image_size, list_photos, without_ending
from gscpe.datasets.split import every_nth, every_nth_text
from gscpe.datasets.tum import read_trajectory
from gscpe.datasets.yaml_file import mapping_with, read_yaml
from gscpe.errors import CameraError, DatasetError
from gscpe.geometry.camera import Camera
from gscpe.geometry.se3 import inverse

NAME = "FAST-LIVO2"
SOURCE = "https://github.com/hku-mars/FAST-LIVO2 (its README links the data set)"
QUERY_EVERY = 4


def read_fast_livo2(root: str | Path, scene: str, time_offset: float = 0.0) -> Dataset:
    """A sequence of FAST-LIVO2: ``ROOT/SCENE/images/STAMP.png``, ``trajectory.txt``, ...

    - ``images/STAMP.png``: named by their time in seconds, as in FAST-LIVO2's ``Log/image``;
    - ``trajectory.txt``: TUM, its ``Log/image/image_poses.txt`` or ``Log/result/SCENE.txt``: of
      the IMU in the world;
    - ``camera_pinhole.yaml``: its ``config/camera_pinhole.yaml``;
    - ``avia.yaml``: its ``config/avia.yaml``, of which the extrinsics are taken. Without this
      file the trajectory is the camera's.

    Poses are interpolated between stamps at most 0.1 s from the photo; photos without are left
    out. Of the others, sorted by name, the first, fifth, ninth, ... are queries: one to three
    references.

    Args:
        time_offset: seconds to be added to the photos' names to get the trajectory's time; 0
            for photos that FAST-LIVO2 saved, ``img_time_offset`` for those out of the bag.

    Raises:
        DatasetError: a file is missing or has another form.
        MissingDependencyError: PyYAML is not installed.
    """
    folder = Path(root) / scene
    image_folder = folder / "images"
    if not image_folder.is_dir():
        raise missing(image_folder, f"{SOURCE}, as Log/image")
    names = list_photos(image_folder)
    if not names:
        raise DatasetError(f"{image_folder} has no photos STAMP.png; they come from {SOURCE}")
    trajectory = read_trajectory(
        folder / "trajectory.txt", f"{SOURCE}, as Log/image/image_poses.txt"
    )
    cam_from_body = _read_extrinsics(folder / "avia.yaml")
    poses = {}
    for name in names:
        world_from_body = trajectory.at(_stamp(image_folder / name) + time_offset)
        if world_from_body is not None:
            poses[name] = cam_from_body @ inverse(world_from_body)
    camera = _read_camera(folder / "camera_pinhole.yaml", image_folder / names[0])
    return make_dataset(
        name=NAME,
        scene=scene,
        image_folder=image_folder,
        cameras=dict.fromkeys(names, camera),
        truths={"trajectory": poses},
        queries=every_nth(poses, QUERY_EVERY),
        split=every_nth_text(QUERY_EVERY),
    )


def _stamp(path: Path) -> float:
    try:
        return float(without_ending(path.name))
    except ValueError:
        raise DatasetError(
            f"{path}: the name must be the time in seconds, as 1669.25.png"
        ) from None


def read_vikit_camera(path: Path) -> Camera:
    """The pinhole camera of a vikit calibration (camera_pinhole.yaml), at the size that was
    calibrated; OpenCV's pixels become ours.

    Raises:
        DatasetError: the file is missing or has another form.
        MissingDependencyError: PyYAML is not installed.
    """
    source = f"{SOURCE}, config/camera_pinhole.yaml"
    tree = read_yaml(path, source)
    # cam_fx in ROS 1; some ROS 2 versions say fx.
    prefix = "cam_" if mapping_with(tree, "cam_fx") is not None else ""
    values = mapping_with(tree, f"{prefix}fx")
    if values is None:
        raise DatasetError(f"{path}: cam_fx is missing; it comes from {source}")
    model = str(values.get("cam_model", values.get("model", "Pinhole")))
    if model.lower() != "pinhole":
        raise DatasetError(
            f"{path}: camera model {model!r} is not supported; undistort the photos first"
        )

    def value(key: str, default: float | None = None) -> float:
        return number_at(values, prefix + key, str(path), default)

    calibrated = value("width"), value("height")
    if not all(1 <= length <= 1e6 and length == int(length) for length in calibrated):
        raise DatasetError(f"{path}: {calibrated} is not a possible image size")
    # d0 to d3 are OpenCV's k1, k2, p1, p2. The calibration has OpenCV's pixels, too: the centre
    # of the top-left one is (0, 0), ours is (0.5, 0.5).
    distortion = [value(f"d{i}", 0.0) for i in range(4)]
    parameters = [value("fx"), value("fy"), value("cx") + 0.5, value("cy") + 0.5, *distortion]
    try:
        return Camera.from_colmap("OPENCV", int(calibrated[0]), int(calibrated[1]), parameters)
    except CameraError as error:
        raise DatasetError(f"{path}: {error}") from None


def _read_camera(path: Path, photo: Path) -> Camera:
    """The camera at the size of the photo."""
    calibrated = read_vikit_camera(path)
    width, height = image_size(photo)
    # FAST-LIVO2 saves photos at `scale` times their size, rounded to whole pixels.
    if abs(width * calibrated.height / calibrated.width - height) > 1.0:
        raise DatasetError(
            f"{photo} is {width}x{height}, which is not a scaled "
            f"{calibrated.width}x{calibrated.height} of {path}"
        )
    return calibrated.resized(width, height)


def _read_extrinsics(path: Path) -> Float64Array:
    """``cam_from_body``, (4, 4); the identity where the file is missing.

    In FAST-LIVO2, (extrinsic_R, extrinsic_T) map LiDAR points to the IMU (the body), and
    (Rcl, Pcl) LiDAR points to the camera.
    """
    if not path.is_file():
        return np.eye(4)
    values = mapping_with(read_yaml(path, SOURCE), "Rcl")
    if values is None:
        raise DatasetError(f"{path}: Rcl is missing; it comes from {SOURCE}, config/avia.yaml")
    imu_from_lidar = _transform(values, "extrinsic_R", "extrinsic_T", path)
    cam_from_lidar = _transform(values, "Rcl", "Pcl", path)
    return np.asarray(cam_from_lidar @ inverse(imu_from_lidar))


def _transform(values: Any, rotation: str, translation: str, path: Path) -> Float64Array:
    matrix = np.eye(4)
    try:
        matrix[:3, :3] = np.reshape(np.asarray(values[rotation], dtype=np.float64), (3, 3))
        matrix[:3, 3] = np.asarray(values[translation], dtype=np.float64)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DatasetError(
            f"{path}: expected {rotation} with 9 and {translation} with 3 numbers ({error})"
        ) from None
    return inverse(invert_pose(matrix, f"{path}, {rotation} and {translation}"))
