# SPDX-License-Identifier: Apache-2.0
"""Steps of the least squares against their definitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import random_pose

from gscpe.coarse.least_squares import Matches2D3D
from gscpe.geometry import Camera, se3
from gscpe.geometry.intrinsics import FOCAL
from gscpe.geometry.projection import pose_jacobian, project, transform_points, unproject

CAMERA = Camera.pinhole(640, 480, fx=520.0, fy=540.0, cx=310.0, cy=236.0)
CELLS = 10


def some(rng: np.random.Generator, count: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World points, (N, 3), their pixels with 2 pixels of noise, (N, 2), and a pose near theirs."""
    pose = random_pose(rng)
    pixels = rng.uniform((0, 0), (640, 480), (count, 2))
    points = transform_points(
        se3.inverse(pose), unproject(CAMERA, pixels, rng.uniform(1.0, 4.0, count))
    )
    pixels = np.clip(pixels + 2.0 * rng.normal(size=pixels.shape), 0.0, (639.9, 479.9))
    return points, pixels, se3.exp(1e-3 * rng.normal(size=6)) @ pose


@pytest.mark.parametrize("zoom", [None, 1.0, 1.2])
def test_a_step_against_its_definition(zoom: float | None, rng: np.random.Generator) -> None:
    points, pixels, pose = some(rng)
    camera = CAMERA
    if zoom is not None:
        camera = Camera.pinhole(640, 480, fx=zoom * 520.0, fy=zoom * 540.0, cx=310.0, cy=236.0)
    in_camera = transform_points(pose, points)
    predicted = project(camera, in_camera)
    residuals = pixels - predicted
    squared = np.sum(residuals**2, axis=1)
    near = squared < 300.0**2 if zoom == 1.2 else squared < 3.0**2
    cells = np.floor(pixels / 64.0)
    alike = np.array([np.sum(np.all(cells[near] == cell, axis=1)) for cell in cells[near]])
    weights = 1.0 / (1.0 + squared[near] / 1.5**2) / alike
    jacobian = pose_jacobian(camera, in_camera[near])
    if zoom is not None:
        by_focal = predicted[near] - np.array([310.0, 236.0])
        jacobian = np.concatenate([jacobian, by_focal[:, :, None]], axis=2)
    hessian = np.einsum("n,nij,nik->jk", weights, jacobian, jacobian)
    gradient = np.einsum("n,nij,ni->j", weights, jacobian, residuals[near])

    matches = Matches2D3D(points, pixels, CAMERA, CELLS)
    change = None if zoom is None else np.log(zoom) * np.eye(5)[FOCAL]
    found = matches.equations(pose, 300.0 if zoom == 1.2 else 3.0, 1.5, 4, change)
    assert found is not None
    unknowns = len(hessian)  # all but the other four numbers of the camera
    found = replace(
        found,
        hessian=found.hessian[:unknowns, :unknowns],
        gradient=found.gradient[:unknowns],
    )
    np.testing.assert_allclose(found.hessian, hessian, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(found.gradient, gradient, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(found.step(), np.linalg.solve(hessian, gradient), rtol=1e-6)
    variance = np.sum(weights * squared[near]) / (2.0 * np.sum(weights))
    assert found.variance() == pytest.approx(variance)


def test_points_behind_the_camera_are_never_near(rng: np.random.Generator) -> None:
    points, pixels, pose = some(rng)
    behind = pose.copy()
    behind[2, 3] -= 2.5
    matches = Matches2D3D(points, pixels, CAMERA, CELLS)
    ahead = transform_points(behind, points)[:, 2] > 0
    assert 0 < ahead.sum() < len(points)
    seen = matches.projected(behind)
    np.testing.assert_array_equal(np.isfinite(seen.squared), ahead)
    assert not seen.within(1e9)[~ahead].any()
    assert matches.equations(pose, 1e-9, 1.0, 4) is None


def test_what_is_not_determined_is_not_moved() -> None:
    """One point, seen twice: two numbers for six unknowns."""
    points, pixels = np.array([[0.0, 0.0, 2.0]] * 2), np.array([[312.0, 237.0]] * 2)
    equations = Matches2D3D(points, pixels, CAMERA, CELLS).equations(np.eye(4), 10.0, 1.0, 1)
    assert equations is not None
    step = equations.step()
    assert np.all(np.isfinite(step))
    assert np.linalg.norm(step) < 0.02
    moved = project(CAMERA, transform_points(se3.exp(step), points))
    np.testing.assert_allclose(moved, pixels, atol=0.02)
