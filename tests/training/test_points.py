# SPDX-License-Identifier: Apache-2.0
"""Points: read, triangulated, and what they become."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, write_colmap_model

from gscpe.errors import ColmapModelError
from gscpe.geometry import se3
from gscpe.geometry.neighbours import pairs_by_pose
from gscpe.photos import write_image

pytest.importorskip("numba")
pytest.importorskip("pycolmap")

from gscpe.training.depth import PointDepths
from gscpe.training.points import PointCloud, extent_of, first_gaussians, read_colmap_points
from gscpe.training.settings import TrainingSettings
from gscpe.training.triangulation import triangulated_points


def test_points_are_triangulated_at_the_known_poses(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    camera, poses = room_camera(200, 150), {}
    for i in range(5):
        name = f"photo {i}.png"
        poses[name] = se3.exp(rng.normal(0.0, (0.12,) * 3 + (0.03,) * 3)) @ ROOM_POSE
        shot = room().shoot(camera, poses[name], samples=2)
        write_image(tmp_path / "photos" / name, shot.uint8)
    write_colmap_model(tmp_path / "model", camera, poses)
    before = {path.name: path.read_bytes() for path in (tmp_path / "model").iterdir()}
    assert read_colmap_points(tmp_path / "model") is None
    cloud = triangulated_points(tmp_path / "model", tmp_path / "photos")
    for name, indices in zip(poses, cloud.seen_in(list(poses)), strict=True):
        depths = PointDepths.of(cloud.positions[indices], camera, poses[name])
        assert len(depths) > 100
        shown = room().shoot(camera, poses[name]).depth[depths.rows, depths.columns]
        assert np.median(np.abs(shown - depths.depths)) < 0.01
    in_cam = cloud.positions @ ROOM_POSE[:3, :3].T + ROOM_POSE[:3, 3]
    shot = room().shoot(camera, ROOM_POSE)
    u = camera.fx * in_cam[:, 0] / in_cam[:, 2] + camera.cx
    v = camera.fy * in_cam[:, 1] / in_cam[:, 2] + camera.cy
    seen = (u > 0) & (v > 0) & (u < camera.width) & (v < camera.height)
    assert np.count_nonzero(seen) > 200
    at = v[seen].astype(int), u[seen].astype(int)
    assert np.median(np.abs(shot.depth[at] - in_cam[seen, 2])) < 0.01
    off = shot.uint8[at].astype(int) - cloud.colours[seen]
    assert np.median(np.abs(off)) < 12
    assert before == {path.name: path.read_bytes() for path in (tmp_path / "model").iterdir()}


def test_photos_that_look_elsewhere_are_not_paired() -> None:
    back = se3.exp([0, 0, 0, 0, np.pi, 0])
    poses = np.stack([np.eye(4), se3.exp([0.1, 0, 0, 0, 0.1, 0]), back, back])
    assert pairs_by_pose(poses, range(12)) == [(0, 1), (2, 3)]


def test_first_gaussians_are_as_wide_as_their_neighbours_are_away() -> None:
    grid = 0.1 * np.moveaxis(np.mgrid[:7, :7, :7], 0, -1).reshape(-1, 3).astype(np.float64)
    colours = np.tile(np.array([[255, 0, 51]], dtype=np.uint8), (len(grid), 1))
    parameters = first_gaussians(PointCloud(grid, colours), 5.0, TrainingSettings())
    np.testing.assert_allclose(parameters.scales, 0.1, rtol=1e-5)
    scene = parameters.scene(0, antialiased=False)
    np.testing.assert_allclose(0.5 + 0.28209479 * scene.sh[:, 0], [[1, 0, 0.2]] * 343, atol=1e-6)
    few = first_gaussians(PointCloud(grid, colours), 5.0, TrainingSettings(max_gaussians=200))
    assert len(few) == 200


def test_extent_is_that_of_the_cameras() -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = (-1.0, 0.0, 1.0)
    assert extent_of(poses) == pytest.approx(1.1)


def test_points_of_a_photo_are_found_whatever_the_slashes() -> None:
    indices = np.array([3, 7])
    cloud = PointCloud(
        np.zeros((200, 3)), np.zeros((200, 3), dtype=np.uint8), {"seq\\a.png": indices}
    )
    known, unknown = cloud.seen_in(["seq/a.png", "b.png"])
    np.testing.assert_array_equal(known, indices)
    assert not len(unknown)


def test_bad_points() -> None:
    with pytest.raises(ColmapModelError, match="3 points are too few"):
        PointCloud(np.zeros((3, 3)), np.zeros((3, 3), dtype=np.uint8))
    with pytest.raises(ColmapModelError, match="NaN or infinite"):
        PointCloud(np.full((200, 3), np.nan), np.zeros((200, 3), dtype=np.uint8))
    with pytest.raises(ColmapModelError, match="as many colours"):
        PointCloud(np.zeros((200, 3)), np.zeros((199, 3), dtype=np.uint8))
