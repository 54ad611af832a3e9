# SPDX-License-Identifier: Apache-2.0
"""The unit of a model: from known poses, GPS, or a distance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from walks import walk_poses, write_jpeg

from gscpe.errors import ReconstructionError, SettingsError
from gscpe.geometry import se3
from gscpe.geometry.similarity_transform import Similarity
from gscpe.geometry.up import common_up
from gscpe.photos.gps import gps_from_exif, local_metres
from gscpe.poses import write_pose_file
from gscpe.reconstruction.frame import levelled
from gscpe.reconstruction.scale import (
    ScaleSource,
    robust_similarity,
    scaled_like_gps,
    scaled_like_poses,
)

ORIGIN = np.array([47.3769, -8.5417, 408.0])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_a_third_of_wrong_points_does_no_harm(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(15, 3))
    rotation = se3.exp([0, 0, 0, *rng.normal(size=3)])[:3, :3]
    true = Similarity(float(rng.uniform(0.1, 10)), rotation, rng.normal(size=3))
    seen = true.apply(points)
    seen[:5] += rng.normal(size=(5, 3)) * 3 * true.scale
    found, inliers = robust_similarity(points, seen)
    np.testing.assert_allclose(found.apply(points), true.apply(points), atol=1e-6 * true.scale)
    assert np.all(inliers[5:])


def test_local_metres_are_those_of_the_ellipsoid() -> None:
    """Against the differences of geocentric coordinates, turned to east, north and up."""

    def geocentric(position: NDArray[np.float64]) -> NDArray[np.float64]:
        a, f = 6_378_137.0, 1 / 298.257223563
        lat, lon = np.radians(position[:2])
        n = a / np.sqrt(1 - f * (2 - f) * np.sin(lat) ** 2)
        across = (n + position[2]) * np.cos(lat)
        z = (n * (1 - f) ** 2 + position[2]) * np.sin(lat)
        return np.array([across * np.cos(lon), across * np.sin(lon), z])

    positions = ORIGIN + np.array([[0.001, 0.0, 5.0], [0.0, 0.002, -3.0], [-0.001, 0.001, 0.0]])
    lat, lon = np.radians(ORIGIN[:2])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    axes = np.stack([east, np.cross(up, east), up])
    expected = [axes @ (geocentric(p) - geocentric(ORIGIN)) for p in positions]
    np.testing.assert_allclose(local_metres(positions, ORIGIN), expected, atol=0.03)


def test_gps_is_read_as_it_was_written(tmp_path: Path) -> None:
    grey = np.full((60, 80, 3), 90, dtype=np.uint8)
    for latitude, longitude, altitude in ((47.5, 8.25, 408.0), (-33.75, -70.5, -12.0)):
        write_jpeg(tmp_path / "a.jpg", grey, gps=(latitude, longitude, altitude))
        assert gps_from_exif(tmp_path / "a.jpg") == pytest.approx((latitude, longitude, altitude))
    write_jpeg(tmp_path / "b.jpg", grey)
    assert gps_from_exif(tmp_path / "b.jpg") is None


def level_walk(spread: float) -> dict[str, NDArray[np.float64]]:
    """A walk in a circle, z up, in units of which a metre is a half."""
    poses = {}
    for i in range(20):
        angle = 2 * np.pi * i / 20
        pose = np.eye(4)
        pose[:3, :3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
        pose[:3, 3] = -pose[:3, :3] @ np.array([np.cos(angle), np.sin(angle), 0.05]) * spread * 2
        poses[f"{i}.jpg"] = pose
    return poses


def test_gps_gives_scale_and_north(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    poses = level_walk(spread=30.0)
    heading = 0.7
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    gps = {}
    for number, (name, pose) in enumerate(poses.items()):
        centre = -pose[:3, :3].T @ pose[:3, 3]
        east, north = turn @ centre[:2] / 2 + rng.normal(0, 1.0, 2)
        if number in (3, 11):
            east += 80.0  # a reflection off a house
        metre = 360 / 40_008_000
        gps[name] = (
            float(ORIGIN[0] + north * metre),
            float(ORIGIN[1] + east * metre / np.cos(np.radians(ORIGIN[0]))),
            float(ORIGIN[2] + rng.normal(0, 5)),
        )
    moved, origin = scaled_like_gps(poses, gps)
    assert moved.scale == pytest.approx(0.5, rel=0.03)
    assert np.arctan2(moved.rotation[1, 0], moved.rotation[0, 0]) == pytest.approx(
        heading, abs=0.05
    )
    np.testing.assert_allclose(moved.rotation[2], [0, 0, 1])
    assert origin[0] == pytest.approx(ORIGIN[0], abs=1e-3)
    with pytest.raises(ReconstructionError, match="spread over"):
        scaled_like_gps(
            level_walk(1.0), {name: (47 + rng.normal(0, 1e-4), 8.0, 0.0) for name in gps}
        )


def test_known_poses_that_do_not_tell(tmp_path: Path) -> None:
    poses = {f"{i}.jpg": pose for i, pose in enumerate(walk_poses(6))}
    path = tmp_path / "known.txt"
    write_pose_file(path, {"other.jpg": np.eye(4), "0.jpg": poses["0.jpg"]}, "hloc")
    with pytest.raises(ReconstructionError, match="1 of the 6 photos"):
        scaled_like_poses(poses, path)
    line = {}
    for i, name in enumerate(poses):
        line[name] = np.eye(4)
        line[name][0, 3] = i
    write_pose_file(path, line, "hloc")
    with pytest.raises(ReconstructionError, match="on one line"):
        scaled_like_poses(poses, path)


def test_depth_images(tmp_path: Path) -> None:
    assert ScaleSource.parse(f"depth:{tmp_path}") == ScaleSource("depth", depth=tmp_path)
    (tmp_path / "a,b").mkdir()
    assert ScaleSource.parse(f"depth:{tmp_path / 'a,b'},5000").per_metre == 5000
    assert ScaleSource.parse(f"depth:{tmp_path / 'a,b'}").depth == tmp_path / "a,b"
    for text in (f"depth:{tmp_path},much", f"depth:{tmp_path},-1", f"depth:{tmp_path}/none"):
        with pytest.raises(SettingsError, match="depth"):
            ScaleSource.parse(text)


@pytest.mark.parametrize(
    "text", ["distance:a,b", "distance:a,a,1", "distance:a,b,-1", "nothing.txt"]
)
def test_scales_that_are_none(text: str) -> None:
    with pytest.raises(SettingsError):
        ScaleSource.parse(text)


def test_level_cameras_say_what_is_up() -> None:
    rng = np.random.default_rng(0)
    tilt = se3.exp([0, 0, 0, 0.4, -0.8, 1.1])
    poses = np.stack([pose @ tilt for pose in walk_poses(12)])
    up = common_up(poses)
    assert up is not None
    assert up @ (tilt[:3, :3].T @ (0.0, -1.0, 0.0)) > np.cos(np.radians(4))
    points = rng.normal(size=(50, 3)) + 7.0
    moved = levelled(poses, points, up)
    np.testing.assert_allclose(moved.rotation @ up, [0, 0, 1], atol=1e-12)
    assert np.linalg.det(moved.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(moved.apply(np.median(points, axis=0)), 0.0, atol=1e-12)
    assert common_up(np.stack([np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])])) is None
