# SPDX-License-Identifier: Apache-2.0
"""Culling and sorting by compute shaders: the order of NumPy, to the bit, and its picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import random_pose, random_scene, simple_camera
from numpy.typing import NDArray

from gscpe.errors import RenderError
from gscpe.geometry import Camera
from gscpe.render import DriverInfo, driver_info, gl_rasterizer
from gscpe.render.gl_rasterizer import GlRasterizer
from gscpe.render.gpu_sort import GL_NEEDED, pays_on
from gscpe.render.visibility_order import VisibilityOrder, depth_order, view_depths
from gscpe.splats import GaussianScene

FACING_AWAY = np.diag([-1.0, 1.0, -1.0, 1.0])


def has_compute_shaders() -> bool:
    try:
        return driver_info().version_code >= GL_NEEDED
    except RenderError:
        return False


needs_compute = pytest.mark.skipif(not has_compute_shaders(), reason="the driver has no GL 4.3")


def gpu_order(
    scene: GaussianScene, camera: Camera, pose: NDArray[np.float64]
) -> NDArray[np.uint32]:
    rasterizer = GlRasterizer(scene, gpu_sort=True)
    assert rasterizer._gpu_order is not None
    assert rasterizer._context is not None
    with rasterizer._context:
        rasterizer._gpu_order.update(camera, pose)
        order = rasterizer._projection.read_order()
    rasterizer.close()
    return order


def assert_sorted(
    order: NDArray[np.uint32], scene: GaussianScene, pose: NDArray[np.float64]
) -> None:
    """Farthest first as depth_order has it, ties and all."""
    indices = np.sort(order).astype(np.int64)
    depths = view_depths(np.ascontiguousarray(scene.means.T), pose)[indices]
    np.testing.assert_array_equal(order, indices[depth_order(depths, indices)][::-1])


@needs_compute
@pytest.mark.parametrize("count", [1, 2, 255, 256, 1023, 1024, 1025, 4096, 70_001])
def test_the_order_is_that_of_numpy(count: int, rng: np.random.Generator) -> None:
    """Around the sizes of a workgroup (256) and of a block (1024), and many blocks."""
    pose = random_pose(rng)
    scene = random_scene(rng, count, 0, cam_from_world=pose, scale=(0.002, 0.02))
    camera = simple_camera()
    order = gpu_order(scene, camera, pose)
    assert_sorted(order, scene, pose)
    expected = VisibilityOrder(scene).back_to_front(camera, pose)
    # What NumPy rounds otherwise when culling is half a pixel outside the image.
    assert len(set(order.tolist()) ^ set(expected.tolist())) <= 1 + count // 10_000
    assert len(order) >= count // 3 or count < 3


@needs_compute
def test_of_equal_depths_the_first_is_in_front(rng: np.random.Generator) -> None:
    scene = random_scene(rng, 5000, 0)
    means = np.zeros((5000, 3), np.float32)
    means[:, 2] = rng.choice(np.array([2.0, 2.0000002, 3.0, 300.0], np.float32), 5000)
    scene = replace(scene, means=means)
    order = gpu_order(scene, simple_camera(), np.eye(4))
    assert len(order) == 5000
    expected = np.lexsort((np.arange(5000), means[:, 2]))[::-1]
    np.testing.assert_array_equal(order, expected)


@needs_compute
def test_all_depths_equal(rng: np.random.Generator) -> None:
    scene = random_scene(rng, 3000, 0)
    scene = replace(scene, means=np.tile(np.array([0, 0, 2], np.float32), (3000, 1)))
    order = gpu_order(scene, simple_camera(), np.eye(4))
    np.testing.assert_array_equal(order, np.arange(3000)[::-1])


@needs_compute
def test_depths_of_all_magnitudes(rng: np.random.Generator) -> None:
    """Every digit of the keys takes part."""
    scene = random_scene(rng, 20_000, 0)
    means = np.zeros((20_000, 3), np.float32)
    means[:, 2] = np.exp(rng.uniform(np.log(0.21), np.log(1e14), 20_000))
    scene = replace(scene, means=means)
    order = gpu_order(scene, simple_camera(), np.eye(4))
    np.testing.assert_array_equal(order, np.argsort(means[:, 2], kind="stable")[::-1])


@needs_compute
def test_nothing_in_view_then_something(rng: np.random.Generator) -> None:
    """Counts of an earlier view do not show through."""
    scene, camera = random_scene(rng, 3000, 1), simple_camera()
    rasterizer = GlRasterizer(scene, gpu_sort=True)
    first = rasterizer.render(camera, np.eye(4))
    empty = rasterizer.render(camera, FACING_AWAY)
    again = rasterizer.render(camera, np.eye(4))
    rasterizer.close()
    assert first.opacity.max() > 0.5
    for array in (empty.rgb, empty.opacity, empty.depth):
        np.testing.assert_array_equal(array, 0.0)
    np.testing.assert_array_equal(again.rgb, first.rgb)


@needs_compute
@pytest.mark.parametrize("degree", [0, 3])
def test_the_picture_is_the_same(degree: int, rng: np.random.Generator) -> None:
    scene = random_scene(rng, 2500, degree, opacity=(0.0, 1.0), antialiased=degree == 3)
    by_gpu = GlRasterizer(scene, gpu_sort=True, tiles=False)
    by_numpy = GlRasterizer(scene, gpu_sort=False)
    for camera in (simple_camera(), simple_camera(33, 61, 40.0)):
        a, b = by_gpu.render(camera, np.eye(4)), by_numpy.render(camera, np.eye(4))
        for name in ("rgb", "opacity", "depth", "depth_variance"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    by_gpu.close()
    by_numpy.close()


def test_it_is_for_gpus_with_compute_shaders() -> None:
    def driver(version: int, is_software: bool) -> DriverInfo:
        return DriverInfo("name", "vendor", "version", version, is_software)

    assert pays_on(driver(430, False))
    assert not pays_on(driver(420, False))
    assert not pays_on(driver(450, True))


def test_asking_for_it_from_an_old_driver(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = DriverInfo("name", "vendor", "3.3 (Core Profile)", 330, False)
    monkeypatch.setattr(gl_rasterizer, "describe", lambda _: old)
    with pytest.raises(RenderError, match=r"needs OpenGL 4\.3; this is 3\.3"):
        GlRasterizer(random_scene(rng, 10, 0), gpu_sort=True)
