# SPDX-License-Identifier: Apache-2.0
"""The covariance of poses from matches: calibrated, and large where little is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray
from test_pnp import CAMERA, SETTINGS, some_matches

from gscpe.coarse.pnp import estimate_absolute_pose
from gscpe.geometry import pose_difference, se3
from gscpe.geometry.projection import transform_points, unproject


def deviations(covariance: NDArray[np.float64]) -> tuple[float, float]:
    """Of the camera's centre and its rotation, in their worst directions: units, degrees."""
    centre, rotation = (np.linalg.eigvalsh(covariance[i : i + 3, i : i + 3])[-1] for i in (0, 3))
    return float(np.sqrt(centre)), float(np.degrees(np.sqrt(rotation)))


def test_a_crowd_in_one_cell_counts_as_one(rng: np.random.Generator) -> None:
    """300 copies of one match, all off by the same 2 pixels, move the pose no more than it
    alone does, and make it no surer."""
    matches = some_matches(rng, 150)
    noisy = matches.pixels + 0.5 * rng.normal(size=matches.pixels.shape)
    noisy[0] = (320.0, 224.0)  # in the middle of a cell, 64 pixels wide, which it gets alone
    others = np.any(np.floor(noisy / 64) != np.floor(noisy[0] / 64), axis=1)
    others[0] = True
    points, noisy = matches.points[others], noisy[others]
    in_camera = unproject(CAMERA, noisy[:1] + np.array([2.0, 0.0]), np.array([2.0]))
    points[:1] = transform_points(se3.inverse(matches.pose), in_camera)
    crowd = np.concatenate([np.zeros(300, dtype=int), np.arange(1, len(points))])
    alone, crowded = (
        estimate_absolute_pose(points[which], noisy[which], CAMERA, matches.pose, SETTINGS)
        for which in (np.arange(len(points)), crowd)
    )
    assert alone is not None
    assert crowded is not None
    assert crowded.inliers.sum() == alone.inliers.sum() + 299
    assert pose_difference(crowded.cam_from_world, alone.cam_from_world).distance < 1e-9
    np.testing.assert_allclose(crowded.covariance, alone.covariance, rtol=1e-6)

    scattered = noisy[crowd]
    scattered[:300] += rng.uniform(-0.5, 0.5, (300, 2))
    held, pulled = (
        estimate_absolute_pose(points[crowd], scattered, CAMERA, matches.pose, settings)
        for settings in (SETTINGS, replace(SETTINGS, cells=100_000))  # each its own cell
    )
    assert held is not None
    assert pulled is not None
    away = [pose_difference(p.cam_from_world, alone.cam_from_world) for p in (held, pulled)]
    assert away[1].degrees > 3 * away[0].degrees


@pytest.mark.parametrize("alike", [1, 2])
def test_the_covariance_is_that_of_the_errors(alike: int, rng: np.random.Generator) -> None:
    """One match a cell, and noise that so many neighbouring cells share: the normalized error
    squared would average 6 times as many, were it not for the correlation in the settings."""
    errors = []
    columns, rows = np.meshgrid(np.arange(10), np.arange(7))
    centres = np.stack([columns.ravel(), rows.ravel()], axis=1) * np.float64(64.0) + 32.0
    for _ in range(40):
        pose = random_pose(rng)
        in_camera = unproject(CAMERA, centres, rng.uniform(1.0, 5.0, len(centres)))
        points = transform_points(se3.inverse(pose), in_camera)
        noise = np.repeat(rng.normal(size=(len(centres) // alike, 2)), alike, axis=0)
        found = estimate_absolute_pose(points, centres + 0.3 * noise, CAMERA, pose, SETTINGS)
        assert found is not None
        xi = se3.log(pose @ se3.inverse(found.cam_from_world))
        errors.append(xi @ np.linalg.solve(found.covariance, xi))
    assert np.mean(errors) == pytest.approx(6.0 * alike / SETTINGS.noise_correlation, rel=0.35)


@pytest.mark.parametrize("shape", ["a line", "a corner of the photo", "far away"])
def test_what_does_not_fix_a_pose_gives_no_sure_one(shape: str, rng: np.random.Generator) -> None:
    """Beside the same number of matches all over the photo, the pose is 20 times less sure."""
    matches = some_matches(rng)
    noise = 0.5 * rng.normal(size=matches.pixels.shape)
    t = rng.uniform(-0.5, 0.5, (200, 3))
    in_camera = {
        "a line": np.stack([t[:, 0], 0.5 * t[:, 0], 2 + 0.3 * t[:, 0]], axis=1),
        "a corner of the photo": 0.05 * t + np.array([0.8, 0.6, 2.0]),
        "far away": 100 * (t + np.array([0, 0, 2.0])),
    }[shape]
    points = transform_points(se3.inverse(matches.pose), in_camera)
    exact = in_camera[:, :2] / in_camera[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    sure, unsure = (
        estimate_absolute_pose(p, pixels + noise, CAMERA, matches.pose, SETTINGS)
        for p, pixels in ((matches.points, matches.pixels), (points, exact))
    )
    assert sure is not None
    assert unsure is not None
    assert np.isfinite(unsure.covariance).all()
    assert deviations(unsure.covariance)[0] > 20 * deviations(sure.covariance)[0]
    if shape != "far away":  # the horizon tells directions well
        assert deviations(unsure.covariance)[1] > 20 * deviations(sure.covariance)[1]
