# SPDX-License-Identifier: Apache-2.0
"""Culling loses nothing that shows, and what is left is sorted."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from helpers import random_pose, random_scene, simple_camera
from hypothesis import example, given
from hypothesis import strategies as st
from numpy_compositor import composite

from gscpe.geometry import Camera
from gscpe.geometry.projection import project, transform_points
from gscpe.render.splatting import SlopeLimits
from gscpe.render.visibility_order import VisibilityOrder
from gscpe.splats import GaussianScene

seeds = st.integers(0, 2**32 - 1)


def scattered_scene(rng: np.random.Generator, count: int = 60) -> GaussianScene:
    """All around the camera, thin and fat, faint and opaque."""
    scene = random_scene(rng, count, 0, scale=(1e-3, 2.0), opacity=(0.0, 1.0))
    opacities = np.where(rng.random(count) < 0.3, 0.02 * scene.opacities, scene.opacities)
    means = rng.normal(size=(count, 3)) * rng.choice([0.5, 2.0, 8.0], (count, 1))
    return replace(scene, means=means.astype(np.float32), opacities=opacities.astype(np.float32))


def random_camera(rng: np.random.Generator) -> Camera:
    """16x12, from long lenses to very wide angles, the principal point anywhere near."""
    fx, fy = np.exp(rng.uniform(np.log(3.0), np.log(100.0), 2))
    cx, cy = rng.uniform(-10.0, 26.0), rng.uniform(-10.0, 22.0)
    return Camera.pinhole(16, 12, fx=fx, fy=fy, cx=cx, cy=cy)


@given(seeds)
def test_culling_changes_no_pixel(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene, camera, pose = scattered_scene(rng), random_camera(rng), random_pose(rng)
    order = VisibilityOrder(scene).back_to_front(camera, pose)
    everything = composite(scene, camera, pose)
    visible = composite(scene, camera, pose, only=order)
    np.testing.assert_allclose(visible.rgb, everything.rgb, atol=1e-12)
    np.testing.assert_allclose(visible.opacity, everything.opacity, atol=1e-12)
    np.testing.assert_allclose(visible.depth, everything.depth, atol=1e-9)


@given(seeds)
def test_the_order_is_back_to_front(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene, camera, pose = scattered_scene(rng, 200), random_camera(rng), random_pose(rng)
    order = VisibilityOrder(scene).back_to_front(camera, pose)
    assert order.dtype == np.uint32
    assert len(set(order.tolist())) == len(order)
    z = transform_points(pose, scene.means.astype(np.float64))[order, 2]
    assert np.all(z > scene.near - 1e-5)
    assert np.all(np.diff(z) <= 1e-5)


def test_culling_culls(rng: np.random.Generator) -> None:
    """Beside, behind, too near, too faint: gone; the rest stays."""
    count = 400
    scene = random_scene(rng, count, 0, scale=(0.001, 0.01), opacity=(0.5, 0.9))
    means, opacities = scene.means.copy(), scene.opacities.copy()
    means[0:50, 2] *= -1.0
    means[50:100, 0] = 2.0 * means[50:100, 2]
    means[100:150, 1] = -2.0 * means[100:150, 2]
    means[150:200] *= 0.1 / means[150:200, 2:]
    opacities[200:250] = 0.0039
    scene = replace(scene, means=means, opacities=opacities)
    camera = simple_camera()
    order = VisibilityOrder(scene).back_to_front(camera, np.eye(4))
    assert order.min() >= 250
    pixels = project(camera, means[250:].astype(np.float64))
    inside = np.all((pixels > 0) & (pixels < [camera.width, camera.height]), axis=1)
    assert set(250 + np.flatnonzero(inside)) <= set(order.tolist())
    assert len(order) < 1.2 * inside.sum()


def test_of_equal_depths_the_first_is_in_front() -> None:
    scene = random_scene(np.random.default_rng(0), 2000, 0)
    means = np.zeros((2000, 3), np.float32)
    means[:, 2] = np.repeat([2.0, 3.0], 1000)
    scene = replace(scene, means=means)
    order = VisibilityOrder(scene).back_to_front(simple_camera(), np.eye(4))
    np.testing.assert_array_equal(order, np.arange(2000)[::-1])


def test_nothing_in_view(rng: np.random.Generator) -> None:
    order = VisibilityOrder(random_scene(rng, 50, 0))
    away = np.diag([-1.0, 1.0, -1.0, 1.0])
    assert order.back_to_front(simple_camera(), away).shape == (0,)


@given(st.floats(0.0, 1.0, width=32))
@example(np.float32(1 / 255))
@example(np.nextafter(np.float32(1 / 255), np.float32(0)))
@example(np.nextafter(np.float32(1 / 255), np.float32(1)))
def test_any_opacity_is_taken_without_a_warning(opacity: float) -> None:
    scene = random_scene(np.random.default_rng(0), 1, 0)
    scene = replace(
        scene,
        means=np.array([[0, 0, 2]], np.float32),
        opacities=np.array([opacity], np.float32),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        order = VisibilityOrder(scene).back_to_front(simple_camera(), np.eye(4))
    if opacity > 1.001 / 255:
        assert order.tolist() == [0]


@pytest.mark.parametrize("opacity", [0.001, 0.0039])
def test_gaussians_below_the_threshold_are_never_drawn(opacity: float) -> None:
    scene = random_scene(np.random.default_rng(0), 30, 0, opacity=(opacity / 2, opacity))
    assert len(VisibilityOrder(scene).back_to_front(simple_camera(), np.eye(4))) == 0


def test_the_slope_limits_are_those_of_3dgs_for_a_centred_camera() -> None:
    camera = Camera.pinhole(640, 480, fx=500.0, fy=400.0, cx=320.0, cy=240.0)
    limits = SlopeLimits.of(camera)
    assert limits.high_x == pytest.approx(1.3 * 320 / 500)
    assert limits.low_x == pytest.approx(-1.3 * 320 / 500)
    assert limits.high_y == pytest.approx(1.3 * 240 / 400)
    assert limits.low_y == pytest.approx(-1.3 * 240 / 400)
