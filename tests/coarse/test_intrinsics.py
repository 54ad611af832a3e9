# SPDX-License-Identifier: Apache-2.0
"""Cameras from matches: right, or left open."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray

from gscpe.coarse import (
    CameraEstimate,
    IntrinsicsSettings,
    PnPSettings,
    estimate_intrinsics,
    probable_camera,
)
from gscpe.coarse.intrinsics import check_intrinsics, solve_intrinsics
from gscpe.coarse.least_squares import Matches2D3D
from gscpe.coarse.pnp import refine_absolute_pose
from gscpe.errors import SettingsError
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.geometry.lens import image_of_directions
from gscpe.geometry.projection import project, transform_points, unproject

TRUE_FOCAL = 525.0
NOISE = 0.5


def with_focal(focal: float) -> Camera:
    return Camera.pinhole(640, 480, fx=focal, fy=focal, cx=311.0, cy=247.0)


def seen_points(
    rng: np.random.Generator, depth: tuple[float, float], outliers: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """300 world points, noisy pixels of which the first are chance, and the pose."""
    pose = random_pose(rng)
    exact = rng.uniform([0, 0], [640, 480], (300, 2))
    in_camera = unproject(with_focal(TRUE_FOCAL), exact, rng.uniform(*depth, 300))
    pixels = exact + NOISE * rng.normal(size=exact.shape)
    pixels[:outliers] = rng.uniform([0, 0], [640, 480], (outliers, 2))
    return transform_points(se3.inverse(pose), in_camera), pixels, pose


def estimate(
    points: NDArray[np.float64], pixels: NDArray[np.float64], guess: float
) -> CameraEstimate | str:
    return estimate_intrinsics(
        points, pixels, with_focal(guess * TRUE_FOCAL), PnPSettings(), IntrinsicsSettings()
    )


@pytest.mark.parametrize("guess", [0.6, 0.9, 1.3, 1.7])
def test_a_wrong_guess(guess: float) -> None:
    """40% outliers, half a pixel of noise, wherever the search begins."""
    points, pixels, pose = seen_points(np.random.default_rng(round(10 * guess)), (1.0, 5.0), 120)
    found = estimate(points, pixels, guess)
    assert isinstance(found, CameraEstimate), found
    relative = found.camera.fx / TRUE_FOCAL - 1.0
    assert abs(relative) < 3.0 * found.relative_sigma
    assert 1e-4 < found.relative_sigma < 3e-3
    sigmas = np.sqrt(np.diag(np.array(found.camera.covariance)))
    assert abs(np.log(found.camera.fy / found.camera.fx)) < 3.0 * sigmas[1]
    assert abs(found.camera.cx - 311.0) < 3.0 * sigmas[2] * TRUE_FOCAL < 15.0
    assert abs(found.camera.cy - 247.0) < 3.0 * sigmas[3] * TRUE_FOCAL < 15.0
    assert found.camera.distortion and abs(found.camera.distortion[0]) < 3.0 * sigmas[4] < 0.05
    assert 175 <= found.inliers <= 190
    error = pose_difference(found.cam_from_world, pose)
    assert error.distance < 0.01
    assert error.degrees < 0.2


def test_the_deviation_is_that_of_the_errors() -> None:
    """Over 40 draws: the squared error over its variance averages 1, times the factor by
    which real errors are more alike than these."""
    squares = []
    for seed in range(40):
        points, pixels, pose = seen_points(np.random.default_rng(seed), (1.0, 5.0), 0)
        # From the true pose's surroundings: few steps, and those near, are fast.
        settings = IntrinsicsSettings(widest=0.98, narrowest=1.02, steps=1)
        found = estimate_intrinsics(
            points, pixels, with_focal(TRUE_FOCAL), PnPSettings(max_iterations=100), settings
        )
        assert isinstance(found, CameraEstimate), found
        squares.append((np.log(found.camera.fx / TRUE_FOCAL) / found.relative_sigma) ** 2)
        assert pose_difference(found.cam_from_world, pose).distance < 0.01
    # 300 matches in 70 cells are more than one a cell, so this is cautious, never bold.
    assert 0.05 < PnPSettings().noise_correlation * np.mean(squares) < 1.5


def test_a_wall_seen_straight_on_leaves_it_open(rng: np.random.Generator) -> None:
    """From far with a long lens, and from near with a short one, it looks the same."""
    points, pixels, _ = seen_points(rng, (2.0, 2.0), 0)
    reason = estimate(points, pixels, 1.2)
    assert isinstance(reason, str)
    assert "do not determine it" in reason


def test_a_wall_seen_aslant_tells(rng: np.random.Generator) -> None:
    pixels = rng.uniform([0, 0], [640, 480], (300, 2))
    camera = with_focal(TRUE_FOCAL)
    in_camera = unproject(camera, pixels, np.ones(300))
    in_camera *= (2.0 / (in_camera @ [0.6, -0.2, 1.0]))[:, None]
    assert in_camera[:, 2].min() > 0.5
    np.testing.assert_allclose(project(camera, in_camera), pixels, atol=1e-9)
    found = estimate(in_camera, pixels, 1.2)
    assert isinstance(found, CameraEstimate), found
    assert found.camera.fx == pytest.approx(TRUE_FOCAL, rel=1e-4)


@pytest.mark.parametrize("count", [0, 3, 29])
def test_too_few_matches(count: int, rng: np.random.Generator) -> None:
    points, pixels, _ = seen_points(rng, (1.0, 5.0), 0)
    reason = estimate(points[:count], pixels[:count], 1.0)
    assert isinstance(reason, str)
    assert "30 needed" in reason


def test_chance_matches(rng: np.random.Generator) -> None:
    points, pixels, _ = seen_points(rng, (1.0, 5.0), 300)
    assert isinstance(estimate(points, pixels, 1.0), str)


@pytest.mark.parametrize(
    "wrong",
    [
        {"widest": 0.0},
        {"narrowest": 0.9},
        {"steps": 0},
        {"around": 0.5},
        {"ordinary": -1.0},
        {"min_inliers": 0},
        {"max_relative_sigma": 0.0},
        {"principal_sigma": -0.01},
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        IntrinsicsSettings(**wrong)


@pytest.mark.parametrize("factor", [0.8, 0.9, 0.97, 1.0, 1.03, 1.1, 1.25])
def test_matches_tell_a_wrong_focal_length(factor: float) -> None:
    """From the best pose of the wrong camera, on which only matches of one depth agree."""
    points, pixels, pose = seen_points(np.random.default_rng(7), (1.5, 3.5), 60)
    wrong = with_focal(factor * TRUE_FOCAL)
    start = pose.copy()
    start[2, 3] += (factor - 1.0) * 2.5
    found = check_intrinsics(points, pixels, wrong, start, PnPSettings())
    assert found is not None
    assert abs(np.log(found.ratio * factor)) < 4.0 * found.relative_sigma < 0.02
    assert np.sqrt(found.camera.fx * found.camera.fy) == pytest.approx(found.ratio * wrong.fx)
    assert pose_difference(found.cam_from_world, pose).distance < 0.02


def test_unequal_focal_lengths_keep_their_ratio() -> None:
    points, pixels, pose = seen_points(np.random.default_rng(1), (1.0, 5.0), 0)
    oblong = replace(with_focal(TRUE_FOCAL), fy=1.2 * TRUE_FOCAL)
    pixels[:, 1] = oblong.cy + 1.2 * (pixels[:, 1] - oblong.cy)
    found = check_intrinsics(points, pixels, oblong, pose, PnPSettings())
    assert found is not None
    assert found.camera.fy / found.camera.fx == pytest.approx(1.2, rel=0.003)
    assert found.ratio == pytest.approx(1.0, abs=0.005)


LENS = Camera(640, 480, 515.0, 522.0, 302.0, 255.0, (-0.12, *(0.0,) * 7))
"""Not what anybody would guess; seen_points() are pixels of a camera without all that."""


def through_lens(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels of the camera of seen_points() as LENS has them."""
    slopes = (pixels - [311.0, 247.0]) / TRUE_FOCAL
    seen, ahead = image_of_directions(LENS, np.column_stack([slopes, np.ones(len(slopes))]))
    assert ahead.all()
    return seen


def off(camera: Camera, true: Camera) -> NDArray[np.float64]:
    """The five numbers from the true camera to another one."""
    aspect = np.log(camera.fy / camera.fx) - np.log(true.fy / true.fx)
    focal = 0.5 * np.log(camera.fx * camera.fy / true.fx / true.fy)
    right, down = (camera.cx - true.cx) / true.fx, (camera.cy - true.cy) / true.fy
    k1, true_k1 = ((each.distortion or (0.0,))[0] for each in (camera, true))
    return np.array([focal, aspect, right, down, k1 - true_k1])


def test_the_jacobian_is_the_derivative(rng: np.random.Generator) -> None:
    points, pixels, pose = seen_points(rng, (1.0, 5.0), 0)
    matches = Matches2D3D(points, pixels, with_focal(TRUE_FOCAL), 10)
    change = np.array([0.05, 0.02, 0.01, -0.02, -0.15])
    equations = matches.equations(pose, np.inf, 1e9, 1, change)
    assert equations is not None
    errors, columns = matches.projected(pose, change).errors, []
    for axis in 1e-6 * np.eye(11):
        ahead, behind = (
            matches.projected(se3.exp(sign * axis[:6]) @ pose, change + sign * axis[6:]).errors
            for sign in (1.0, -1.0)
        )
        columns.append((behind - ahead).ravel() / 2e-6)
    jacobian = np.array(columns)
    weighted = jacobian * np.tile(equations.weights, 2)
    np.testing.assert_allclose(equations.hessian, weighted @ jacobian.T, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(equations.gradient, weighted @ errors.ravel(), rtol=1e-5, atol=1e-2)


def test_without_a_change_the_camera_is_the_given_one(rng: np.random.Generator) -> None:
    points, pixels, pose = seen_points(rng, (1.0, 5.0), 0)
    matches = Matches2D3D(points, pixels, LENS.without_distortion(), 10)
    given, same = (matches.projected(pose, change) for change in (None, np.zeros(5)))
    np.testing.assert_array_equal(given.errors, same.errors)
    alone, both = (matches.equations(pose, 50.0, 1.0, 4, change) for change in (None, np.zeros(5)))
    assert alone is not None and both is not None
    np.testing.assert_allclose(alone.hessian, both.hessian[:6, :6])


def test_a_whole_camera_from_matches() -> None:
    """Unequal focal lengths, a principal point 12 pixels off, and k1 = -0.12, with a third of
    outliers."""
    points, pixels, pose = seen_points(np.random.default_rng(5), (1.0, 5.0), 100)
    settings = IntrinsicsSettings(aspect_sigma=0.02)
    guess = with_focal(0.8 * TRUE_FOCAL)
    found = estimate_intrinsics(points, through_lens(pixels), guess, PnPSettings(), settings)
    assert isinstance(found, CameraEstimate), found
    wrong, covariance = off(found.camera, LENS), np.array(found.camera.covariance)
    assert wrong @ np.linalg.solve(covariance, wrong) < 20.0
    assert np.all(np.abs(wrong) < [0.005, 0.005, 0.01, 0.01, 0.02])
    assert 185 <= found.inliers <= 210
    error = pose_difference(found.cam_from_world, pose)
    assert error.distance < 0.03
    assert error.degrees < 0.7


def test_the_covariance_is_that_of_the_errors() -> None:
    """Over cameras drawn from what is expected beforehand: the normalized error of all five
    numbers averages 5, less by at most the factor by which real errors are more alike than
    these."""
    draws, squares, pnp = np.random.default_rng(11), [], PnPSettings(cells=200)
    expected = np.inf, 0.003, 0.007, 0.007, 0.02
    for seed in range(60):
        points, pixels, pose = seen_points(np.random.default_rng(seed), (1.0, 5.0), 0)
        true = draws.normal(size=5) * [0.01, *expected[1:]]
        matches = Matches2D3D(points, pixels, with_focal(TRUE_FOCAL), pnp.cells)
        moved = (matches.projected(pose).errors - matches.projected(pose, true).errors).T
        found = solve_intrinsics(
            points, pixels + moved, with_focal(TRUE_FOCAL), pose, pnp, expected
        )
        assert found is not None
        wrong = found.change - true
        squares.append(wrong @ np.linalg.solve(found.covariance, wrong))
    assert 5.0 / (4.0 / 3.0 * pnp.noise_correlation) < np.mean(squares) < 5.0


def test_a_plain_camera_is_recognized() -> None:
    """Where the matches are no evidence against it, the principal point stays near the middle, and
    the deviation is smaller than it would be otherwise."""
    points, pixels, pose = seen_points(np.random.default_rng(3), (1.0, 5.0), 0)
    guess, pnp = with_focal(TRUE_FOCAL), PnPSettings()
    settings = IntrinsicsSettings(covariance_factor=1.0)
    found = solve_intrinsics(points, pixels, guess, pose, pnp, settings.sigmas)
    assert found is not None
    camera = probable_camera(guess, [found], settings)
    for number in (2, 3, 4):
        assert abs(off(camera, guess)[number]) < abs(found.change[number])
        assert camera.covariance[number][number] < found.covariance[number, number]
    same = probable_camera(guess, [found], replace(settings, plain_sigmas=1.0))
    np.testing.assert_allclose(off(same, guess), found.change, atol=1e-9)
    np.testing.assert_allclose(np.array(same.covariance), found.covariance, rtol=1e-6)
    wider = probable_camera(guess, [found], replace(settings, covariance_factor=1.6))
    np.testing.assert_allclose(wider.covariance_matrix(), 1.6 * camera.covariance_matrix())
    assert wider.with_covariance(camera.covariance_matrix()) == camera


def test_several_photos_tell_more_than_one() -> None:
    guess, pnp, settings = with_focal(TRUE_FOCAL), PnPSettings(), IntrinsicsSettings()
    estimates = []
    for seed in range(6):
        points, pixels, pose = seen_points(np.random.default_rng(seed), (1.0, 5.0), 0)
        found = solve_intrinsics(points, through_lens(pixels), guess, pose, pnp, settings.sigmas)
        assert found is not None
        estimates.append(found)
    one = probable_camera(guess, estimates[:1], settings)
    all_of_them = probable_camera(guess, estimates, settings)
    wrong = np.abs(off(all_of_them, LENS))
    assert np.all(wrong < [0.003, 0.005, 0.004, 0.004, 0.01])
    sigmas = np.sqrt(np.diag(np.array(all_of_them.covariance)))
    assert np.all(sigmas < 0.7 * np.sqrt(np.diag(np.array(one.covariance))))


@pytest.mark.parametrize(
    ("wrong", "number"),
    [
        (replace(LENS.without_distortion(), fy=1.04 * LENS.fx, fx=LENS.fx), 1),
        (replace(LENS.without_distortion(), cx=LENS.cx + 20.0), 2),
        (replace(LENS.without_distortion(), cy=LENS.cy - 20.0), 3),
    ],
)
def test_matches_tell_what_is_wrong(wrong: Camera, number: int) -> None:
    """Of a photo that was undistorted right, and of one that was not at all."""
    points, pixels, pose = seen_points(np.random.default_rng(7), (1.5, 3.5), 60)
    right = LENS.without_distortion()
    for lens, k1 in ((right, 0.0), (LENS, -0.12)):
        seen = through_lens(pixels)
        if lens.is_pinhole:
            seen = (pixels - [311.0, 247.0]) / TRUE_FOCAL * [lens.fx, lens.fy] + [lens.cx, lens.cy]
        start = refine_absolute_pose(points, seen, wrong, pose, PnPSettings())
        found = check_intrinsics(points, seen, wrong, start, PnPSettings())
        assert found is not None
        asked, sigmas = off(right, wrong), np.sqrt(np.diag(found.covariance))
        assert abs(asked[number]) > 4.0 * sigmas[number]
        asked[4] = k1
        assert np.all(np.abs(found.change - asked) < 4.0 * sigmas)


def test_few_points_ask_for_nothing() -> None:
    points, pixels, pose = seen_points(np.random.default_rng(2), (1.0, 5.0), 0)
    few = slice(0, 5)
    camera = with_focal(TRUE_FOCAL)
    assert check_intrinsics(points[few], pixels[few], camera, pose, PnPSettings()) is None
    behind = pose.copy()
    behind[:3] *= -1.0
    assert check_intrinsics(points, pixels, camera, behind, PnPSettings()) is None
