# SPDX-License-Identifier: Apache-2.0
"""Chunks of Gaussians: the curve keeps neighbours together, and no view loses anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from helpers import random_pose, random_scene, simple_camera
from hypothesis import given
from hypothesis import strategies as st

from gscpe.geometry import Camera
from gscpe.render.cpu_rasterizer import CpuRasterizer
from gscpe.render.spatial_chunks import SpatialChunks, morton_order
from gscpe.render.splatting import SlopeLimits, sigmas_in_sight
from gscpe.splats import GaussianScene

seeds = st.integers(0, 2**32 - 1)


def wide_scene(rng: np.random.Generator, count: int = 3000) -> GaussianScene:
    """Clusters all around, so that whole chunks lie beside and behind any camera."""
    scene = random_scene(rng, count, 0, scale=(1e-3, 0.3), opacity=(0.0, 1.0))
    centres = rng.normal(scale=6.0, size=(20, 3))
    means = centres[rng.integers(0, 20, count)] + rng.normal(scale=0.5, size=(count, 3))
    return replace(scene, means=means.astype(np.float32))


def touches(scene: GaussianScene, camera: Camera, cam_from_world: np.ndarray) -> np.ndarray:
    """Which Gaussians may reach the image, one by one, by the bound of the rasterizers."""
    points = scene.means.astype(np.float64) @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    z = points[:, 2]
    sigmas = sigmas_in_sight(scene.opacities)
    with np.errstate(divide="ignore", invalid="ignore"):
        stretch = max(camera.fx, camera.fy) * SlopeLimits.of(camera).stretch()
        reach = sigmas * (scene.scales.max(axis=1) / z * stretch + np.sqrt(0.3))
        u = camera.fx * points[:, 0] / z + camera.cx
        v = camera.fy * points[:, 1] / z + camera.cy
    inside = (u + reach > 0) & (v + reach > 0) & (u - reach < camera.width)
    inside &= (v - reach < camera.height) & (z > scene.near) & (scene.opacities >= 1 / 255)
    return np.asarray(inside)


@given(seeds)
def test_no_gaussian_in_view_is_left_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene, cam_from_world = wide_scene(rng), random_pose(rng)
    camera = Camera.pinhole(64, 48, fx=70.0, fy=60.0, cx=rng.uniform(-30, 90), cy=20.0)
    chunks = SpatialChunks.of(scene)
    kept = chunks.order[chunks.positions_in_view(camera, cam_from_world)]
    assert len(np.unique(kept)) == len(kept)
    assert set(np.flatnonzero(touches(scene, camera, cam_from_world))) <= set(kept)


def test_what_lies_beside_and_behind_costs_nothing() -> None:
    rng = np.random.default_rng(0)
    scene = wide_scene(rng, 20_000)
    chunks = SpatialChunks.of(scene)
    kept = len(chunks.positions_in_view(simple_camera(), np.eye(4)))
    needed = np.count_nonzero(touches(scene, simple_camera(), np.eye(4)))
    assert needed <= kept < 0.5 * len(chunks.order)


@given(seeds)
def test_the_order_is_a_permutation_of_what_is_not_faint(seed: int) -> None:
    scene = wide_scene(np.random.default_rng(seed), 700)
    chunks = SpatialChunks.of(scene)
    assert sorted(chunks.order) == list(np.flatnonzero(scene.opacities >= 1 / 255))
    assert chunks.begins[0] == 0
    assert chunks.begins[-1] == len(chunks.order)
    assert np.all(np.diff(chunks.begins) > 0)


def test_the_curve_visits_a_grid_octant_by_octant() -> None:
    corners = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    visited = corners[morton_order(corners.astype(np.float32))]
    for octant in visited.reshape(8, 8, 3):
        assert np.all(np.ptp(octant, axis=0) == 1)


def test_a_far_floater_does_not_coarsen_the_curve() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (1000, 3)).astype(np.float32)
    far = np.concatenate([points, [[1e30, -1e30, 1e30]]]).astype(np.float32)
    visited = morton_order(far)
    steps = np.linalg.norm(np.diff(points[visited[visited < len(points)]], axis=0), axis=1)
    assert np.median(steps) < 0.4


def test_nothing_in_view_renders_as_nothing_and_compiles_all_the_same() -> None:
    scene = random_scene(np.random.default_rng(0), 5, 0)
    behind = replace(scene, means=scene.means - np.float32(100.0))
    view = CpuRasterizer(behind).render(simple_camera(), np.eye(4))
    assert not view.opacity.any()
    assert not view.depth.any()
