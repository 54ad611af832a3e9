# SPDX-License-Identifier: Apache-2.0
"""Known poses, as a device gives them, are refined by what the photos show."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import room
from walks import WALK_CAMERA, walk_poses, write_jpeg

from gscpe.cli.main import main
from gscpe.errors import PoseError, ReconstructionError, SettingsError
from gscpe.geometry import se3
from gscpe.geometry.pose_error import rotation_angle_degrees
from gscpe.geometry.similarity_transform import Similarity
from gscpe.poses import read_pose_file, write_pose_file
from gscpe.reconstruction import (
    KnownPoses,
    PoseRefinementSettings,
    Reconstruction,
    refine_known_poses,
)
from gscpe.reconstruction.epipolar import sampson_distances
from gscpe.reconstruction.pose_adjustment import Bounds, adjust_poses
from gscpe.scene.colmap_database import set_cameras
from gscpe.scene.colmap_model import read_colmap_references

Poses = dict[str, NDArray[np.float64]]

COUNT = 9
_TURN = se3.exp([0, 0, 0, 0.3, -0.5, 0.9])[:3, :3]
GIVEN_FROM_TRUE = Similarity(2.5, _TURN, np.array([40.0, 3.0, 7.0]))
"""The frame of the poses that are given: another unit, turned, and elsewhere."""


@dataclass(frozen=True)
class Device:
    """Photos, the poses that a device gave, the true ones in the same frame, and the model."""

    folder: Path
    given: Poses
    truth: Poses
    source: KnownPoses
    model: Reconstruction


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Device:
    """Poses are off by 1 cm and 0.3 degrees; some photos do not belong where they are said to."""
    root = tmp_path_factory.mktemp("device")
    rng = np.random.default_rng(3)
    truth, given = {}, {}
    for i, pose in enumerate(walk_poses(COUNT)):
        name = f"{i}.jpg"
        write_jpeg(root / "photos" / name, room().shoot(WALK_CAMERA, pose, samples=2).uint8)
        error = np.concatenate([_length(rng, 0.01), _length(rng, np.radians(0.3))])
        truth[name] = GIVEN_FROM_TRUE.cam_from_b(pose)
        given[name] = GIVEN_FROM_TRUE.cam_from_b(se3.exp(error) @ pose)
    odd = walk_poses(COUNT + 2)
    for name, number, where in (("elsewhere.jpg", 7, odd[3]), ("wrong.jpg", None, odd[5])):
        scene = room() if number is None else room(number)
        write_jpeg(root / "photos" / name, scene.shoot(WALK_CAMERA, where, samples=2).uint8)
        given[name] = GIVEN_FROM_TRUE.cam_from_b(where)
    given["wrong.jpg"] = se3.exp([0.5, 0.4, 0.1, 0.1, 0.3, 0.2]) @ given["wrong.jpg"]
    write_jpeg(root / "photos" / "blank.jpg", np.full((180, 240, 3), 130, dtype=np.uint8))
    given["blank.jpg"] = given["4.jpg"]
    write_pose_file(root / "poses.txt", given, "hloc")
    camera = WALK_CAMERA.colmap_text()
    (root / "cameras.txt").write_text("".join(f"{name} {camera}\n" for name in given))
    given = dict(read_pose_file(root / "poses.txt").poses)
    source = KnownPoses(root / "photos", None, given, dict.fromkeys(given, WALK_CAMERA), 0.4)
    model = refine_known_poses(source, root / "model")
    return Device(root, given, truth, source, model)


def _length(rng: np.random.Generator, length: float) -> NDArray[np.float64]:
    direction = rng.normal(size=3)
    return np.asarray(length * direction / np.linalg.norm(direction))


def errors_of(poses: Poses, truth: Poses) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distances of centres, units of the poses; angles, degrees."""
    centres, angles = [], []
    for name, pose in poses.items():
        if name in truth:
            off = pose[:3, :3].T @ pose[:3, 3] - truth[name][:3, :3].T @ truth[name][:3, 3]
            centres.append(np.linalg.norm(off))
            angles.append(rotation_angle_degrees(pose[:3, :3] @ truth[name][:3, :3].T))
    return np.array(centres), np.array(angles)


def refined(device: Device) -> Poses:
    """Read from the model that was written."""
    read = read_colmap_references(device.model.model_folder, device.model.image_folder)
    return dict(zip(read.names, read.cam_from_world, strict=True))


def test_poses_come_closer_to_the_truth(device: Device) -> None:
    poses = refined(device)
    assert set(poses) == set(device.truth) == set(device.model.placed)
    before = errors_of(device.given, device.truth)
    after = errors_of(poses, device.truth)
    assert np.median(before[0]) == pytest.approx(2.5 * 0.01, rel=0.05)
    assert np.median(after[0]) < 0.5 * np.median(before[0])
    assert np.median(after[1]) < 0.5 * np.median(before[1])
    facts = device.model.refined
    assert facts is not None
    assert facts.error_after < 0.3 < facts.error_before
    assert facts.groups == 1
    moved = errors_of(poses, {name: device.given[name] for name in poses})
    assert facts.moved == pytest.approx(np.median(moved[0]))
    assert facts.moved_most == pytest.approx(np.max(moved[0]))
    assert facts.turned == pytest.approx(np.median(moved[1]))


def test_frame_and_scale_are_kept(device: Device) -> None:
    poses = refined(device)
    spreads = []
    for some in (poses, {name: device.truth[name] for name in poses}):
        centres = np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in some.values()])
        spreads.append(np.linalg.norm(centres - centres.mean(axis=0)))
    assert spreads[0] == pytest.approx(spreads[1], rel=0.02)
    assert device.model.frame.metres_per_unit == 0.4
    assert device.model.points > 200 and device.model.error < 0.5


def test_photos_that_do_not_belong_are_named(device: Device) -> None:
    why = device.model.not_placed
    assert set(why) == {"elsewhere.jpg", "wrong.jpg", "blank.jpg"}
    assert "blurred" in why["blank.jpg"] or "features" in why["blank.jpg"]
    assert "nothing that another photo shows" in why["elsewhere.jpg"]
    assert "does not fit its pose" in why["wrong.jpg"]


def test_command(device: Device, capsys: pytest.CaptureFixture[str]) -> None:
    """What is finished is read, not made again."""
    folder = device.folder
    command = [
        *("reconstruct", str(folder / "photos"), "--output", str(folder / "model")),
        *("--poses", str(folder / "poses.txt"), "--cameras", str(folder / "cameras.txt")),
        *("--metres-per-unit", "0.4", "--resume"),
    ]
    assert main(command) == 0
    said = capsys.readouterr()
    assert "9 of 12 photos placed" in said.out and "instead of" in said.out
    assert "not placed: wrong.jpg" in said.err
    stored = json.loads((folder / "model" / "reconstruction.json").read_text())
    assert stored["refined"]["groups"] == 1
    assert main([*command, "--scale-from", "gps"]) == 2
    assert "known poses have a scale" in capsys.readouterr().err


def test_poses_of_other_photos_are_refused(device: Device, tmp_path: Path) -> None:
    """Camera to world, by mistake."""
    names = list(device.truth)
    turned: Poses = {name: se3.inverse(device.given[name]) for name in names}
    cameras = dict.fromkeys(names, WALK_CAMERA)
    source = KnownPoses(device.source.image_folder, None, turned, cameras)
    with pytest.raises(ReconstructionError, match=r"poses do not fit the photos.*world to camera"):
        refine_known_poses(source, tmp_path / "model")


def test_focal_lengths_are_refined_if_asked_for(device: Device, tmp_path: Path) -> None:
    """A camera that is 3% off; the database has all that was matched already."""
    import pycolmap

    database = tmp_path / "database.db"
    database.write_bytes((device.model.model_folder.parents[1] / "database.db").read_bytes())
    wrong = pycolmap.Camera(model="PINHOLE", width=240, height=180, params=[0.0] * 4)
    wrong.params = [1.03 * WALK_CAMERA.fx, 1.03 * WALK_CAMERA.fy, 120.0, 90.0]
    set_cameras(database, dict.fromkeys(device.given, wrong))
    model = adjust_poses(database, device.given, 1.0, Bounds(4.8, 0.96, 4, 30, True, 0))
    for camera in model.cameras.values():
        assert camera.mean_focal_length() == pytest.approx(WALK_CAMERA.fx, rel=0.005)


def test_bad_input(device: Device, tmp_path: Path) -> None:
    photos = device.source.image_folder
    few = {name: device.given[name] for name in ("0.jpg", "1.jpg")}
    cameras: dict[str, Any] = dict.fromkeys(few, WALK_CAMERA)
    with pytest.raises(ReconstructionError, match="2 usable photos"):
        refine_known_poses(KnownPoses(photos, None, few, cameras), tmp_path / "a")
    with pytest.raises(PoseError, match="cameras"):
        refine_known_poses(KnownPoses(photos, None, few), tmp_path / "b")
    with pytest.raises(PoseError, match="no camera"):
        refine_known_poses(KnownPoses(photos, None, few, {"0.jpg": WALK_CAMERA}), tmp_path / "c")
    with pytest.raises(SettingsError):
        PoseRefinementSettings(first_error=0.001)
    with pytest.raises(SettingsError):
        PoseRefinementSettings(least_points=1)


def test_distance_from_the_epipolar_line(rng: np.random.Generator) -> None:
    """To first order, it is the shift across the line; along it, nothing changes."""
    a = se3.exp(rng.normal(0, 0.2, 6))
    b = se3.exp(rng.normal(0, 0.2, 6)) @ se3.exp([0.5, 0, 0, 0, 0, 0])
    points = np.column_stack([rng.uniform(-1, 1, (50, 2)), rng.uniform(2, 4, 50), np.ones(50)])
    rays = []
    for pose in (a, b):
        seen = points @ pose.T
        rays.append(seen[:, :2] / seen[:, 2:3])
    assert np.max(sampson_distances(a, b, *rays)) < 1e-12
    centre_of_a = b @ np.linalg.inv(a) @ [0, 0, 0, 1]
    along = rays[1] - centre_of_a[:2] / centre_of_a[2]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = along[:, ::-1] * (1, -1)
    assert np.max(sampson_distances(a, b, rays[0], rays[1] + 0.01 * along)) < 1e-10
    off = sampson_distances(a, b, rays[0], rays[1] + 1e-4 * across)
    # The shift is shared between both photos.
    assert np.all(off < 1e-4) and np.median(off) > 0.5e-4
    assert np.max(sampson_distances(a, a, rays[0], rays[0])) < 1e-12
