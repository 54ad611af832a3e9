# SPDX-License-Identifier: Apache-2.0
"""Absolute pose from matches: exact, robust, repeatable, and silent where there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from helpers import random_pose
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gscpe.coarse.pnp import PnPSettings, estimate_absolute_pose, refine_absolute_pose
from gscpe.errors import SettingsError
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.geometry.projection import transform_points, unproject

CAMERA = Camera.pinhole(640, 480, fx=525.0, fy=520.0, cx=311.0, cy=247.0)
SETTINGS = PnPSettings()


@dataclass(frozen=True)
class Matches:
    """World points and the pixels where a camera at ``pose`` sees them, before outliers."""

    points: NDArray[np.float64]
    pixels: NDArray[np.float64]
    pose: NDArray[np.float64]

    def with_outliers(self, share: float, rng: np.random.Generator) -> Matches:
        pixels = self.pixels.copy()
        count = round(share * len(pixels))
        pixels[:count] = rng.uniform([0, 0], [640, 480], (count, 2))
        return replace(self, pixels=pixels)


def some_matches(rng: np.random.Generator, count: int = 200) -> Matches:
    pose = random_pose(rng)
    pixels = rng.uniform([0, 0], [640, 480], (count, 2))
    in_camera = unproject(CAMERA, pixels, rng.uniform(1.0, 5.0, count))
    return Matches(transform_points(se3.inverse(pose), in_camera), pixels, pose)


def far_prior(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(se3.exp([0.8, -0.3, 0.5, 0.3, 0.4, -0.2]) @ pose)


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("seed", range(5))
def test_exact_poses(outliers: float, seed: int) -> None:
    """Without noise: a micrometre, whatever the outliers."""
    rng = np.random.default_rng(seed)
    matches = some_matches(rng).with_outliers(outliers, rng)
    found = estimate_absolute_pose(
        matches.points, matches.pixels, CAMERA, far_prior(matches.pose), SETTINGS
    )
    assert found is not None
    error = pose_difference(found.cam_from_world, matches.pose)
    # Outliers that land near their true pixel pull a little, as Cauchy's weights never end.
    assert error.distance < (1e-6 if outliers == 0 else 2e-3)
    assert error.degrees < (1e-5 if outliers == 0 else 0.05)
    true_inliers = np.arange(200) >= round(outliers * 200)
    assert found.inliers[true_inliers].all()
    assert (found.inliers & ~true_inliers).sum() <= 3
    if outliers == 0:
        assert found.rms_pixels < 1e-4


def test_noise_averages_out(rng: np.random.Generator) -> None:
    """Half a pixel of noise on 200 matches: some tenths of a pixel less in the pose."""
    for _ in range(5):
        matches = some_matches(rng)
        noisy = matches.pixels + 0.5 * rng.normal(size=matches.pixels.shape)
        found = estimate_absolute_pose(matches.points, noisy, CAMERA, np.eye(4), SETTINGS)
        assert found is not None
        error = pose_difference(found.cam_from_world, matches.pose)
        assert error.distance < 5e-3
        assert error.degrees < 0.1
        assert found.rms_pixels == pytest.approx(0.5 * np.sqrt(2), rel=0.15)


def test_half_a_pixel(rng: np.random.Generator) -> None:
    """Pixels in OpenCV's convention, whose first centre is (0, 0), give another pose."""
    matches = some_matches(rng)
    found = estimate_absolute_pose(
        matches.points, matches.pixels - 0.5, CAMERA, matches.pose, SETTINGS
    )
    assert found is not None
    assert pose_difference(found.cam_from_world, matches.pose).degrees > 0.03


@given(seed=st.integers(0, 2**31 - 1), count=st.integers(6, 40))
def test_few_exact_matches(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    matches = some_matches(rng, count)
    found = estimate_absolute_pose(
        matches.points, matches.pixels, CAMERA, far_prior(matches.pose), SETTINGS
    )
    assert found is not None
    assert found.inliers.all()
    assert found.rms_pixels < 0.01


def test_the_same_seed_gives_the_same_pose(rng: np.random.Generator) -> None:
    matches = some_matches(rng).with_outliers(0.5, rng)
    noisy = matches.pixels + rng.normal(size=matches.pixels.shape)
    poses = []
    for _ in range(3):
        found = estimate_absolute_pose(matches.points, noisy, CAMERA, np.eye(4), SETTINGS)
        assert found is not None
        poses.append(found.cam_from_world)
    np.testing.assert_array_equal(poses[0], poses[1])
    np.testing.assert_array_equal(poses[0], poses[2])


def test_the_prior_wins_where_sampling_cannot(rng: np.random.Generator) -> None:
    """12 true matches in 400: a sample of four is right once in a million."""
    matches = some_matches(rng, 400).with_outliers(388 / 400, rng)
    lost = estimate_absolute_pose(
        matches.points, matches.pixels, CAMERA, far_prior(matches.pose), SETTINGS
    )
    if lost is not None:
        assert pose_difference(lost.cam_from_world, matches.pose).distance > 0.05
    prior = se3.exp([0.004, 0.003, -0.004, 0.001, -0.001, 0.001]) @ matches.pose
    found = estimate_absolute_pose(matches.points, matches.pixels, CAMERA, prior, SETTINGS)
    assert found is not None
    assert found.inliers[-12:].all()
    error = pose_difference(found.cam_from_world, matches.pose)
    assert error.distance < 0.01
    assert error.degrees < 0.2


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_matches(count: int, rng: np.random.Generator) -> None:
    matches = some_matches(rng, count)
    assert (
        estimate_absolute_pose(matches.points, matches.pixels, CAMERA, matches.pose, SETTINGS)
        is None
    )


def test_chance_matches_hardly_agree() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        matches = some_matches(rng, 100).with_outliers(1.0, rng)
        found = estimate_absolute_pose(
            matches.points, matches.pixels, CAMERA, far_prior(matches.pose), SETTINGS
        )
        assert found is None or found.inliers.sum() < 12


def test_matches_behind_the_camera_do_not_count(rng: np.random.Generator) -> None:
    """A point mirrored through the camera's centre projects to the same pixel."""
    matches = some_matches(rng)
    points = matches.points.copy()
    centre = se3.inverse(matches.pose)[:3, 3]
    points[:50] = 2 * centre - points[:50]
    found = estimate_absolute_pose(points, matches.pixels, CAMERA, matches.pose, SETTINGS)
    assert found is not None
    assert not found.inliers[:50].any()
    assert found.inliers[50:].all()


DEGENERATE = {
    "one point": lambda t: np.stack([0 * t, 0 * t, 0 * t + 2], axis=1),
    "a line": lambda t: np.stack([t, 0.5 * t, 2 + 0.3 * t], axis=1),
    "a line through the camera": lambda t: np.stack([0 * t, 0 * t, 2 + t], axis=1),
}


@pytest.mark.parametrize("shape", DEGENERATE)
def test_degenerate_points_never_move_a_right_prior(shape: str, rng: np.random.Generator) -> None:
    """They do not fix a pose. None is right, and so is a pose that explains them near the
    prior; a pose far away is made up."""
    in_camera = DEGENERATE[shape](rng.uniform(-0.5, 0.5, 30))
    pixels = in_camera[:, :2] / in_camera[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    pose = random_pose(rng)
    points = transform_points(se3.inverse(pose), in_camera)
    found = estimate_absolute_pose(points, pixels, CAMERA, pose, SETTINGS)
    if found is not None:
        assert np.isfinite(found.cam_from_world).all()
        error = pose_difference(found.cam_from_world, pose)
        assert error.distance < 0.01
        assert error.degrees < 0.5


def test_a_plane_is_enough(rng: np.random.Generator) -> None:
    pose = random_pose(rng)
    pixels = rng.uniform([0, 0], [640, 480], (100, 2))
    in_camera = unproject(CAMERA, pixels, np.ones(100))
    in_camera *= (2.0 / (in_camera @ [0.3, -0.2, 1.0]))[:, None]
    points = transform_points(se3.inverse(pose), in_camera)
    found = estimate_absolute_pose(points, pixels, CAMERA, far_prior(pose), SETTINGS)
    assert found is not None
    assert pose_difference(found.cam_from_world, pose).distance < 1e-5


def test_least_squares_from_nearby(rng: np.random.Generator) -> None:
    matches = some_matches(rng)
    start = se3.exp([0.004, -0.003, 0.005, 0.002, -0.001, 0.002]) @ matches.pose
    refined = refine_absolute_pose(matches.points, matches.pixels, CAMERA, start, SETTINGS)
    error = pose_difference(refined, matches.pose)
    assert error.distance < 1e-7
    assert error.degrees < 1e-5


def test_what_is_beyond_twice_the_threshold_does_not_pull(rng: np.random.Generator) -> None:
    """A third of the matches lies 12 pixels to the right of where it should, on something that
    was moved: the others are exact, and so is the pose."""
    matches = some_matches(rng)
    pixels = matches.pixels.copy()
    pixels[:66, 0] += 12.0
    found = estimate_absolute_pose(matches.points, pixels, CAMERA, matches.pose, SETTINGS)
    assert found is not None
    error = pose_difference(found.cam_from_world, matches.pose)
    assert error.distance < 1e-6
    assert error.degrees < 1e-5
    assert not found.inliers[:66].any()


@pytest.mark.parametrize(
    "change",
    [
        {"max_iterations": 0},
        {"inlier_pixels": 0.0},
        {"noise_pixels": -1.0},
        {"confidence": 1.0},
        {"confidence": 0.0},
    ],
)
def test_impossible_settings(change: dict[str, Any]) -> None:
    with pytest.raises(SettingsError):
        replace(SETTINGS, **change)
