# SPDX-License-Identifier: Apache-2.0
"""Tiny data sets in the layouts of their downloads, written with code of their own.

Every writer takes true poses, world to camera, and returns them by the name that the photo must
get from the reader. What a format wants instead (camera to world, centres, other axes) is
computed here from the definitions, not with gscpe. At the end, what reads them.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np
from helpers import random_pose
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from gscpe.datasets import Dataset, read_cambridge, read_fast_livo2, read_seven_scenes

Pose = NDArray[np.float64]
Poses = dict[str, Pose]

SIZE = (64, 48)
LIVO_CAMERA = {
    "cam_model": "Pinhole",
    "cam_width": 128,
    "cam_height": 96,
    "scale": 0.5,
    "cam_fx": 130.5,
    "cam_fy": 131.5,
    "cam_cx": 62.25,
    "cam_cy": 49.75,
    "cam_d0": -0.08,
    "cam_d1": 0.12,
    "cam_d2": -0.001,
    "cam_d3": 0.0003,
}
NVM_FOCAL, NVM_RADIAL = 55.0, -0.08
TRANSFORMS_CAMERA = {
    **{"camera_model": "OPENCV", "w": 64, "h": 48, "fl_x": 60.0, "fl_y": 61.0},
    **{"cx": 31.0, "cy": 25.0, "k1": 0.1, "k2": -0.05, "p1": 0.002, "p2": -0.003},
}
RGBD_CAMERA = "OPENCV 64 48 60 61 31 25 0.1 -0.05 0.002 -0.003"


def some_poses(count: int = 8, seed: int = 3) -> list[Pose]:
    """World-to-camera poses with any rotation."""
    rng = np.random.default_rng(seed)
    return [random_pose(rng) for _ in range(count)]


def write_photo(path: Path, size: tuple[int, int] = SIZE) -> None:
    """A grey photo."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, (128, 128, 128)).save(path)


def write_lines(path: Path, lines: Sequence[str]) -> None:
    """A text file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(line + "\n" for line in lines))


def words(*arrays: Any) -> str:
    """Numbers with 12 digits, blanks between."""
    return " ".join(f"{x:.12g}" for array in arrays for x in np.ravel(array))


def wxyz(pose: Pose) -> NDArray[np.float64]:
    """The quaternion, real part first."""
    return np.asarray(Rotation.from_matrix(pose[:3, :3]).as_quat())[[3, 0, 1, 2]]


def write_matrix(path: Path, pose: Pose) -> None:
    """A 4x4 camera-to-world matrix, as 7-Scenes has it."""
    write_lines(path, ["\t".join(f"{x:.9e}" for x in row) for row in np.linalg.inv(pose)])


def tum_line(stamp: float, world_from_body: Pose) -> str:
    """stamp tx ty tz qx qy qz qw."""
    quaternion = Rotation.from_matrix(world_from_body[:3, :3]).as_quat()
    return f"{stamp:.6f} {words(world_from_body[:3, 3], quaternion)}"


def write_seven_scenes(
    root: Path,
    poses: Sequence[Pose] | None = None,
    scene: str = "redkitchen",
    *,
    focal: float = 52.75,
    ending: str = ".png",
    original: Sequence[Pose] | None = None,
    pgt: str = "pgt/sfm/7scenes",
) -> Poses:
    """The first half is seq-01 (train), the others are seq-03 (test); ``original`` as poses."""
    poses = some_poses() if poses is None else poses
    original = poses if original is None else original
    folder, half = root / scene, len(poses) // 2
    write_lines(folder / "TrainSplit.txt", ["sequence1"])
    write_lines(folder / "TestSplit.txt", ["sequence3"])
    lines: dict[str, list[str]] = {"train": [], "test": []}
    result = {}
    for i, pose in enumerate(poses):
        stem = f"{'seq-01' if i < half else 'seq-03'}/frame-{i % half:06d}"
        write_photo(folder / f"{stem}.color{ending}")
        write_matrix(folder / f"{stem}.pose.txt", original[i])
        line = f"{stem}.color.png {words(wxyz(pose), pose[:3, 3], focal)}"
        lines["train" if i < half else "test"].append(line)
        result[f"{stem}.color{ending}"] = pose
    for split, text in lines.items():
        write_lines(root / pgt / f"{scene}_{split}.txt", text)
    return result


def write_cambridge(
    root: Path, poses: Sequence[Pose] | None = None, scene: str = "KingsCollege"
) -> Poses:
    """seq1 is the training half, seq2 the test half; the .nvm says .jpg where files are .png."""
    poses = some_poses() if poses is None else poses
    folder, half = root / scene, len(poses) // 2
    header = ["Visual Landmark Dataset V1", "ImageFile, Camera Position [X Y Z W P Q R]", ""]
    lines: dict[str, list[str]] = {"train": [*header], "test": [*header]}
    nvm = ["NVM_V3 ", "", str(len(poses))]
    result = {}
    for i, pose in enumerate(poses):
        stem = f"{'seq1' if i < half else 'seq2'}/frame{i + 1:05d}"
        write_photo(folder / f"{stem}.png")
        centre = np.linalg.inv(pose)[:3, 3]
        lines["train" if i < half else "test"].append(f"{stem}.png {words(centre, wxyz(pose))}")
        nvm.append(f"{stem}.jpg\t{words(NVM_FOCAL, wxyz(pose), centre, NVM_RADIAL)} 0 ")
        result[f"{stem}.png"] = pose
    write_lines(folder / "dataset_train.txt", lines["train"])
    write_lines(folder / "dataset_test.txt", lines["test"])
    points = ["", "1", "1 2 3 255 255 255 1 0 0 1.5 2.5", "", "0"]
    write_lines(folder / "reconstruction.nvm", [*nvm, *points])
    return result


def write_fast_livo2(
    root: Path,
    poses: Sequence[Pose] | None = None,
    scene: str = "CBD_Building_01",
    *,
    extrinsics: bool = True,
) -> Poses:
    """Photos every 0.5 s, saved at half size; the trajectory is that of the IMU."""
    poses = some_poses() if poses is None else poses
    folder, stamp = root / scene, 1669290000.25
    cam_from_lidar, imu_from_lidar = np.eye(4), np.eye(4)
    if extrinsics:
        cam_from_lidar, imu_from_lidar = some_poses(2, seed=9)
        calibration = {
            "extrinsic_T": imu_from_lidar[:3, 3].tolist(),
            "extrinsic_R": imu_from_lidar[:3, :3].ravel().tolist(),
            "Rcl": cam_from_lidar[:3, :3].ravel().tolist(),
            "Pcl": cam_from_lidar[:3, 3].tolist(),
        }
        lines = [f"  {key}: {value}" for key, value in calibration.items()]
        write_lines(folder / "avia.yaml", ["common:", "  img_en: 1", "extrin_calib:", *lines])
    trajectory, result = [], {}
    for i, pose in enumerate(poses):
        name = f"{stamp + 0.5 * i:.6f}.png"
        write_photo(folder / "images" / name)
        # p_cam = cam_from_lidar inv(imu_from_lidar) inv(world_from_imu) p_world
        world_from_imu = np.linalg.inv(pose) @ cam_from_lidar @ np.linalg.inv(imu_from_lidar)
        trajectory.append(tum_line(stamp + 0.5 * i, world_from_imu))
        result[name] = pose
    write_lines(folder / "trajectory.txt", trajectory)
    lines = [f"{key}: {value}" for key, value in LIVO_CAMERA.items()]
    write_lines(folder / "camera_pinhole.yaml", lines)
    return result


def write_transforms(
    folder: Path,
    poses: Sequence[Pose] | None = None,
    camera: Mapping[str, Any] | None = None,
    **extra: Any,
) -> Poses:
    """transforms.json with OpenGL axes, photos in images/; ``extra`` goes into the file."""
    poses = some_poses() if poses is None else poses
    frames, result = [], {}
    for i, pose in enumerate(poses):
        name = f"images/frame_{i + 1:05d}.png"
        write_photo(folder / name)
        world_from_cam = np.linalg.inv(pose)
        world_from_cam[:, 1] *= -1.0
        world_from_cam[:, 2] *= -1.0
        frames.append({"file_path": f"./{name}", "transform_matrix": world_from_cam.tolist()})
        result[name] = pose
    tree = {**(TRANSFORMS_CAMERA if camera is None else camera), "frames": frames, **extra}
    (folder / "transforms.json").write_text(json.dumps(tree, indent=1))
    return result


def write_rgbd_folder(
    root: Path, poses: Sequence[Pose] | None = None, *, form: str = "matrices"
) -> Poses:
    """``form`` is "matrices" (poses/NAME.txt), "stamps" or "order" (both trajectory.txt)."""
    poses = some_poses() if poses is None else poses
    lines, result = [], {}
    for i, pose in enumerate(poses):
        stamp = 1341846313.592026 + i / 30
        stem = f"{stamp:.6f}" if form == "stamps" else f"{i:06d}"
        write_photo(root / "rgb" / f"{stem}.png")
        if form == "matrices":
            write_matrix(root / "poses" / f"{stem}.txt", pose)
        lines.append(tum_line(stamp, np.asarray(np.linalg.inv(pose), dtype=np.float64)))
        result[f"{stem}.png"] = pose
    if form != "matrices":
        write_lines(root / "trajectory.txt", lines)
    write_lines(root / "camera.txt", [RGBD_CAMERA])
    return result


def kitchen(root: Path) -> Dataset:
    return read_seven_scenes(root, "redkitchen")


def college(root: Path) -> Dataset:
    return read_cambridge(root, "KingsCollege")


def building(root: Path) -> Dataset:
    return read_fast_livo2(root, "CBD_Building_01")


def query_names(dataset: Dataset) -> list[str]:
    return [query.name for query in dataset.queries]
