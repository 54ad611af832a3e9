# SPDX-License-Identifier: Apache-2.0
"""Depths of points: where they are, what a wrong one costs, and what comes of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import numeric_jacobian, random_pose, simple_camera
from numpy.typing import NDArray
from scenes import room, room_camera

from gscpe.errors import SettingsError, TrainingError
from gscpe.geometry import se3
from gscpe.geometry.projection import pixel_centres, transform_points, unproject
from gscpe.render import RenderedView, Renderer
from gscpe.splats import GaussianScene

pytest.importorskip("numba")

from test_train import SETTINGS, seen, shots

from gscpe.training import train
from gscpe.training.depth import PointDepths, depth_loss
from gscpe.training.settings import TrainingSettings


def view_of(depth: NDArray[np.float32], opacity: float = 1.0) -> RenderedView:
    height, width = depth.shape
    return RenderedView(
        np.zeros((height, width, 3), np.float32), np.full(depth.shape, opacity, np.float32),
        depth, np.zeros_like(depth), simple_camera(width, height), np.eye(4),
    )  # fmt: skip


def test_points_fall_into_the_pixels_that_show_them(rng: np.random.Generator) -> None:
    camera, pose = simple_camera(20, 12), random_pose(rng)
    pixels, depth = pixel_centres(camera).reshape(-1, 2), rng.uniform(1.0, 5.0, 240)
    off = pixels + rng.uniform(-0.49, 0.49, pixels.shape)
    positions = transform_points(se3.inverse(pose), unproject(camera, off, depth))
    outside = unproject(camera, np.array([[-1.0, 5.0], [3.0, 12.5], [5.0, 5.0]]), np.ones(3))
    outside[2] *= -1.0  # behind the camera
    everything = np.concatenate([positions, transform_points(se3.inverse(pose), outside)])
    found = PointDepths.of(everything, camera, pose)
    assert len(found) == 240
    np.testing.assert_array_equal(found.rows, np.arange(240) // 20)
    np.testing.assert_array_equal(found.columns, np.arange(240) % 20)
    np.testing.assert_allclose(found.depths, depth, rtol=1e-6)
    valid = rng.uniform(size=(12, 20)) > 0.5
    masked = PointDepths.of(everything, camera, pose, valid)
    assert len(masked) == np.count_nonzero(valid)
    assert np.all(valid[masked.rows, masked.columns])


def test_gradient_of_the_penalty(rng: np.random.Generator) -> None:
    """Of small errors and of large ones, against central differences; each point counts as many
    pixels as it is said to."""
    depth = rng.uniform(1.0, 3.0, (6, 7)).astype(np.float32)
    errors = np.array([0.001, -0.015, 0.1, -0.4, 2.0])
    rows, columns = np.arange(5), np.array([3, 0, 6, 2, 2])
    points = PointDepths(rows, columns, (depth[rows, columns] * np.exp(errors)).astype(np.float32))

    def loss(at: NDArray[np.float64]) -> NDArray[np.float64]:
        changed = depth.astype(np.float64)
        changed[rows, columns] = at
        return np.array([depth_loss(view_of(changed), points, 3.0)[0]])  # type: ignore[arg-type]

    value, gradient = depth_loss(view_of(depth), points, 3.0)
    numeric = numeric_jacobian(loss, depth[rows, columns].astype(np.float64), step=1e-6)[0]
    np.testing.assert_allclose(gradient.values, numeric, rtol=1e-3)
    np.testing.assert_array_equal(gradient.rows, rows)
    expected = sum(e**2 / 0.04 if abs(e) < 0.02 else abs(e) - 0.01 for e in errors)
    assert value == pytest.approx(3.0 * expected / 42, rel=1e-3)


def test_what_is_hardly_there_has_no_depth() -> None:
    points = PointDepths(np.array([1]), np.array([1]), np.array([2.0], dtype=np.float32))
    depth = np.full((4, 4), 3.0, dtype=np.float32)
    assert depth_loss(view_of(depth), points, 1.0)[0] > 0
    value, gradient = depth_loss(view_of(depth, opacity=0.4), points, 1.0)
    assert value == 0 and not len(gradient.values)


def test_points_bring_surfaces_to_where_they_are() -> None:
    """Three photos of a room leave depths rather free; points bring them nearer to the truth."""
    photos, poses, points = shots()
    settings = dataclasses.replace(SETTINGS, iterations=200, depth_weight=20.0)
    some = [0, 1, 2]

    def off(scene: GaussianScene) -> float:
        """Median relative error of the depth seen from elsewhere."""
        camera, errors = room_camera(64, 48), []
        with Renderer(scene, "cpu") as renderer:
            for pose in poses[3:6]:
                found = renderer.render(camera, pose).depth
                truth = room(smoothness=4.0).shoot(camera, pose).depth
                errors.append(np.abs(np.log(found[found > 0] / truth[found > 0])))
        return float(np.median(np.concatenate(errors)))

    chosen = [photos[i] for i in some]
    with_depths = train(chosen, poses[some], points, settings, seen=[seen()[i] for i in some])
    without = train(chosen, poses[some], points, settings)
    assert off(with_depths) < 0.5 * off(without)


def test_weight_zero_is_as_without() -> None:
    photos, poses, points = shots()
    short = dataclasses.replace(SETTINGS, iterations=5, depth_weight=0.0)
    a, b = (train(photos, poses, points, short, seen=s) for s in (None, seen()))
    np.testing.assert_array_equal(a.means, b.means)
    c = train(photos, poses, points, dataclasses.replace(short, depth_weight=1.0), seen=seen())
    assert np.any(a.means != c.means)


def test_bad_input() -> None:
    photos, poses, points = shots()
    with pytest.raises(TrainingError, match="10 photos, but points that 9 see"):
        train(photos, poses, points, SETTINGS, seen=seen()[1:])
    wrong = [*seen()[:3], np.array([len(points.positions)]), *seen()[4:]]
    with pytest.raises(TrainingError, match="photo 3 sees points that are not among"):
        train(photos, poses, points, SETTINGS, seen=wrong)
    with pytest.raises(SettingsError, match="depth_weight must be"):
        TrainingSettings(depth_weight=-1.0)
    with pytest.raises(SettingsError, match="depth_weight_end must be"):
        TrainingSettings(depth_weight_end=0.0)
