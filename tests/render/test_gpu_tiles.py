# SPDX-License-Identifier: Apache-2.0
"""Pictures by compute shaders, tile by tile, and by blending: the reference compositor's, both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import random_pose, random_scene, simple_camera
from numpy.typing import NDArray
from numpy_compositor import composite

from gscpe.errors import RenderError
from gscpe.geometry import Camera
from gscpe.render import RenderedView, driver_info, gpu_tiles
from gscpe.render.gl_rasterizer import GlRasterizer
from gscpe.render.gpu_sort import GL_NEEDED
from gscpe.splats import GaussianScene

FACING_AWAY = np.diag([-1.0, 1.0, -1.0, 1.0])


def has_compute_shaders() -> bool:
    try:
        return driver_info().version_code >= GL_NEEDED
    except RenderError:
        return False


needs_compute = pytest.mark.skipif(not has_compute_shaders(), reason="the driver has no GL 4.3")


@pytest.fixture(params=["numpy order, blended", "gpu order, blended", "tiles"])
def way(request: pytest.FixtureRequest) -> str:
    if request.param != "numpy order, blended" and not has_compute_shaders():
        pytest.skip("the driver has no GL 4.3")
    return str(request.param)


def rasterizer(scene: GaussianScene, way: str) -> GlRasterizer:
    return GlRasterizer(scene, gpu_sort=not way.startswith("numpy"), tiles=way == "tiles")


def check(
    scene: GaussianScene, camera: Camera, pose: NDArray[np.float64], way: str
) -> RenderedView:
    """Renders, and fails where the reference differs visibly."""
    gl = rasterizer(scene, way)
    view = gl.render(camera, pose)
    gl.close()
    reference = composite(scene, camera, pose)
    solid = reference.opacity > 0.5
    assert reference.opacity.max() > 0.1
    np.testing.assert_allclose(view.rgb, reference.rgb, atol=1 / 255)
    np.testing.assert_allclose(view.opacity, reference.opacity, atol=1 / 255)
    assert np.abs(view.rgb - reference.rgb).mean() <= 1e-5
    if solid.any():
        depth = np.abs(view.depth - reference.depth)[solid]
        variance = np.abs(view.depth_variance - reference.depth_variance)[solid]
        assert np.quantile(depth / reference.depth[solid], 0.999) <= 1e-3
        assert np.quantile(variance, 0.999) <= 1e-3
    return view


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("size", [(64, 48), (61, 47), (16, 16), (1, 1), (17, 33)])
def test_pictures(size: tuple[int, int], degree: int, way: str, rng: np.random.Generator) -> None:
    """Sizes that tiles of 16 fill, and that they do not."""
    pose = random_pose(rng)
    scene = random_scene(rng, 250, degree, cam_from_world=pose, antialiased=degree == 3)
    check(scene, simple_camera(*size, focal=50.0), pose, way)


def test_needles(way: str, rng: np.random.Generator) -> None:
    """Long and thin ones, far beyond the image at both ends, keep their width and place."""
    pose = random_pose(rng)
    scene = random_scene(rng, 60, 0, cam_from_world=pose)
    scales = np.full((60, 3), 1e-4, np.float32)
    scales[:, 0] = rng.uniform(0.5, 20.0, 60)
    check(replace(scene, scales=scales), simple_camera(61, 47), pose, way)


def test_small_gaussians_are_where_they_are(way: str) -> None:
    """A Gaussian of the low-pass alone: its alpha at each pixel to a thousandth, wherever it
    lies between the pixels. (Not so where a GPU interpolates it
    from the snapped corners of a quad.)"""
    camera = Camera.pinhole(40, 30, fx=300.0, fy=300.0, cx=20.0, cy=15.0)
    for x, y in ((20.0, 15.0), (20.37, 15.11), (20.501, 14.743), (3.127, 28.913)):
        scene = GaussianScene(
            means=np.array([[(x - 20.0) / 300.0, (y - 15.0) / 300.0, 1.0]], np.float32),
            quaternions=np.array([[1, 0, 0, 0]], np.float32),
            scales=np.full((1, 3), 1e-6, np.float32),
            opacities=np.array([0.9], np.float32),
            sh=np.zeros((1, 1, 3), np.float32),
        )
        gl = rasterizer(scene, way)
        view = gl.render(camera, np.eye(4))
        gl.close()
        expected = composite(scene, camera, np.eye(4)).opacity
        visible = expected > 0.01
        np.testing.assert_allclose(view.opacity[visible], expected[visible], rtol=1e-3)


@needs_compute
def test_depths_far_away(rng: np.random.Generator) -> None:
    """Surfaces 1000 units away: depth to a hundred-thousandth, and no variance made of rounding
    alone, since what is summed up is the depth beyond the nearest one."""
    scene = random_scene(rng, 400, 0, scale=(20.0, 60.0), opacity=(0.3, 0.9))
    means = scene.means.copy()
    means *= 1000.0 / means[:, 2:]
    view = check(replace(scene, means=means), simple_camera(), np.eye(4), "tiles")
    seen = view.opacity > 0.5
    np.testing.assert_allclose(view.depth[seen], 1000.0, rtol=1e-5)
    np.testing.assert_allclose(view.depth_variance, 0.0, atol=1e-5)


@needs_compute
def test_lists_grow_with_the_picture(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No Gaussian is left out when there are more pairs than there is room for at first."""
    monkeypatch.setattr(gpu_tiles, "_FIRST_PAIRS", 8)
    scene, camera = random_scene(rng, 300, 1), simple_camera(160, 120)
    gl = rasterizer(scene, "tiles")
    views = [gl.render(c, np.eye(4)) for c in (simple_camera(20, 20), camera, camera)]
    assert gl._tiles is not None
    assert gl._tiles.pairs > 300
    gl.close()
    np.testing.assert_array_equal(views[1].rgb, views[2].rgb)
    reference = composite(scene, camera, np.eye(4))
    np.testing.assert_allclose(views[1].rgb, reference.rgb, atol=1 / 255)


@needs_compute
def test_too_many_pairs_are_blended(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where lists by tile would take too much memory, the picture is the same."""
    monkeypatch.setattr(gpu_tiles, "_FIRST_PAIRS", 8)
    monkeypatch.setattr(gpu_tiles, "MOST_PAIRS", 100)
    scene, camera = random_scene(rng, 300, 1), simple_camera(160, 120)
    pictures = []
    for way in ("tiles", "gpu order, blended"):
        gl = rasterizer(scene, way)
        pictures.append(gl.render(camera, np.eye(4)).rgb)
        gl.close()
    np.testing.assert_array_equal(pictures[0], pictures[1])


@needs_compute
def test_nothing_in_view_then_something(rng: np.random.Generator) -> None:
    scene, camera = random_scene(rng, 3000, 1), simple_camera()
    gl = rasterizer(scene, "tiles")
    first = gl.render(camera, np.eye(4))
    empty = gl.render(camera, FACING_AWAY)
    again = gl.render(camera, np.eye(4))
    gl.close()
    for array in (empty.rgb, empty.opacity, empty.depth, empty.depth_variance):
        np.testing.assert_array_equal(array, 0.0)
    for name in ("rgb", "opacity", "depth", "depth_variance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
        assert getattr(first, name).flags.c_contiguous
        assert getattr(first, name).flags.writeable


@needs_compute
def test_sizes_that_overflow(rng: np.random.Generator) -> None:
    """Gaussians so large that float32 overflows do not spoil the others."""
    scene = random_scene(rng, 200, 0)
    scales = scene.scales.copy()
    scales[::20] = 1e15
    gl = rasterizer(replace(scene, scales=scales), "tiles")
    view = gl.render(simple_camera(), np.eye(4))
    gl.close()
    for array in (view.rgb, view.opacity, view.depth, view.depth_variance):
        assert np.isfinite(array).all()
