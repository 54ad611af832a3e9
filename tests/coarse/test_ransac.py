# SPDX-License-Identifier: Apache-2.0
"""Sampled poses: either solver finds them, among outliers, and the same ones again."""

from __future__ import annotations

import importlib.machinery
import importlib.util
from typing import Literal

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray
from test_pnp import CAMERA, some_matches

from gscpe.coarse.ransac import RansacSettings, choose_solver, sample_absolute_pose
from gscpe.errors import MissingDependencyError, SettingsError
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.geometry.projection import transform_points

Named = Literal["pycolmap", "opencv"]


@pytest.fixture(params=["pycolmap", "opencv"])
def solver(request: pytest.FixtureRequest) -> Named:
    if request.param == "pycolmap":
        pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    found: Named = request.param
    return found


def check(
    found: NDArray[np.float64] | None,
    truth: NDArray[np.float64],
    distance: float = 1e-5,  # OpenCV's solver rounds to float32 on its way
    degrees: float = 1e-4,
) -> None:
    assert found is not None
    assert found.shape == (4, 4)
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-9)
    np.testing.assert_array_equal(found[3], [0, 0, 0, 1])
    error = pose_difference(found, truth)
    assert error.distance < distance
    assert error.degrees < degrees


@pytest.mark.parametrize("outliers", [0.0, 0.5])
@pytest.mark.parametrize("seed", range(4))
def test_exact_poses(seed: int, outliers: float, solver: Named) -> None:
    """Samples of true matches are exact, and outliers have no say in the local optimization
    but for the few that land near their true pixel."""
    rng = np.random.default_rng(seed)
    matches = some_matches(rng).with_outliers(outliers, rng)
    found = sample_absolute_pose(
        matches.points, matches.pixels, CAMERA, RansacSettings(solver=solver)
    )
    if outliers:
        check(found, matches.pose, distance=0.02, degrees=0.5)
    else:
        check(found, matches.pose)


def test_the_same_seed_gives_the_same_pose(rng: np.random.Generator, solver: Named) -> None:
    matches = some_matches(rng).with_outliers(0.5, rng)
    noisy = matches.pixels + rng.normal(size=matches.pixels.shape)
    poses = [
        sample_absolute_pose(
            matches.points, noisy, CAMERA, RansacSettings(solver=solver, seed=seed)
        )
        for seed in (3, 3, 3, 4)
    ]
    assert all(pose is not None for pose in poses)
    np.testing.assert_array_equal(poses[0], poses[1])
    np.testing.assert_array_equal(poses[0], poses[2])
    check(poses[3], matches.pose, distance=0.05, degrees=1.0)


def test_both_solvers_agree(rng: np.random.Generator) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    matches = some_matches(rng, 400).with_outliers(0.3, rng)
    noisy = matches.pixels + 0.3 * rng.normal(size=matches.pixels.shape)
    one = sample_absolute_pose(matches.points, noisy, CAMERA, RansacSettings(solver="pycolmap"))
    other = sample_absolute_pose(matches.points, noisy, CAMERA, RansacSettings(solver="opencv"))
    assert one is not None
    check(other, one, distance=0.01, degrees=0.2)


def test_half_a_pixel(rng: np.random.Generator, solver: Named) -> None:
    """Pixels from a principal point half a pixel aside are another camera's: the pose turns
    by about half a pixel, 0.055 degrees, where the right camera is exact."""
    matches = some_matches(rng)
    check(
        sample_absolute_pose(matches.points, matches.pixels, CAMERA, RansacSettings(solver=solver)),
        matches.pose,
    )
    aside = Camera.pinhole(
        640, 480, fx=CAMERA.fx, fy=CAMERA.fy, cx=CAMERA.cx - 0.5, cy=CAMERA.cy - 0.5
    )
    found = sample_absolute_pose(
        matches.points, matches.pixels, aside, RansacSettings(solver=solver)
    )
    assert found is not None
    assert 0.02 < pose_difference(found, matches.pose).degrees < 0.2


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_too_few_points(count: int, rng: np.random.Generator, solver: Named) -> None:
    matches = some_matches(rng, count)
    found = sample_absolute_pose(
        matches.points, matches.pixels, CAMERA, RansacSettings(solver=solver)
    )
    assert found is None or np.isfinite(found).all()


SHAPES = {
    "one point": lambda t: np.stack([0 * t, 0 * t, 0 * t + 2], axis=1),
    "a line": lambda t: np.stack([t, 0.5 * t, 2 + 0.3 * t], axis=1),
    "a line through the camera": lambda t: np.stack([0 * t, 0 * t, 2 + t], axis=1),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_degenerate_points(shape: str, rng: np.random.Generator, solver: Named) -> None:
    """No pose, or any finite one: they do not tell."""
    in_camera = SHAPES[shape](rng.uniform(-0.5, 0.5, 30))
    pixels = in_camera[:, :2] / in_camera[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    points = transform_points(se3.inverse(random_pose(rng)), in_camera)
    found = sample_absolute_pose(points, pixels, CAMERA, RansacSettings(solver=solver))
    assert found is None or np.isfinite(found).all()


def test_auto_takes_pycolmap_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    there = importlib.machinery.ModuleSpec("pycolmap", None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: there)
    assert choose_solver("auto") == "pycolmap"
    assert choose_solver("opencv") == "opencv"


def test_without_pycolmap(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert choose_solver("auto") == "opencv"
    matches = some_matches(rng)
    by_default = sample_absolute_pose(matches.points, matches.pixels, CAMERA)
    by_opencv = sample_absolute_pose(
        matches.points, matches.pixels, CAMERA, RansacSettings(solver="opencv")
    )
    assert by_default is not None
    np.testing.assert_array_equal(by_default, by_opencv)
    with pytest.raises(MissingDependencyError, match="pip install pycolmap"):
        sample_absolute_pose(
            matches.points, matches.pixels, CAMERA, RansacSettings(solver="pycolmap")
        )


def test_no_such_solver() -> None:
    with pytest.raises(SettingsError, match="auto, pycolmap or opencv, not 'ceres'"):
        choose_solver("ceres")  # type: ignore[arg-type]
