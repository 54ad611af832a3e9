# SPDX-License-Identifier: Apache-2.0
"""Renderers over time: memory, several at once, closing, and what they refuse."""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
import threading
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Callable

import moderngl
import numpy as np
import pytest
from helpers import random_scene, simple_camera
from numpy_compositor import composite

from gscpe.errors import MissingDependencyError, PoseError, RenderError, SettingsError
from gscpe.geometry import Camera
from gscpe.render import (
    DriverInfo,
    Renderer,
    choose_backend,
    cpu_rasterizer,
    driver_info,
    rasterizer,
    shader_source,
)
from gscpe.render.cpu_rasterizer import CpuRasterizer
from gscpe.splats import GaussianScene

FACING_AWAY = np.diag([-1.0, 1.0, -1.0, 1.0])


@pytest.fixture
def scene(rng: np.random.Generator) -> GaussianScene:
    return random_scene(rng, 300, 1)


def resident_megabytes() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


needs_statm = pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="memory is measured through /proc"
)


@needs_statm
@pytest.mark.parametrize("different", [7, 240])
def test_rendering_many_sizes_does_not_grow_memory(
    different: int, scene: GaussianScene, backend: str
) -> None:
    """More sizes in turn than are kept, so that each render makes new targets."""
    cameras = [simple_camera(60 + 17 * i % 103, 60 + 29 * i % 89) for i in range(different)]
    with Renderer(scene, backend) as renderer:
        for i in range(240):
            renderer.render(cameras[i % different], np.eye(4))
            if i == 40:
                gc.collect()
                before = resident_megabytes()
        gc.collect()
        assert resident_megabytes() - before < 4.0


def least_growth(do: Callable[[], object], times: int = 10) -> float:
    """Megabytes by which doing it so many times grows memory, the least of three such rounds:
    what leaks grows each time, what malloc keeps for a thread does not."""
    grown = []
    for _ in range(3):
        gc.collect()
        before = resident_megabytes()
        for _ in range(times):
            do()
        gc.collect()
        grown.append(resident_megabytes() - before)
    return min(grown)


@needs_statm
def test_opening_and_closing_does_not_grow_memory(rng: np.random.Generator, backend: str) -> None:
    """A renderer of this splat holds some 14 MB: one that stays would show."""
    large = random_scene(rng, 30_000, 3, scale=(0.002, 0.01))

    def open_and_close() -> None:
        with Renderer(large, backend) as renderer:
            renderer.render(simple_camera(), np.eye(4))

    # Mesa keeps 0.04 MB of each context, whatever was done with it, NVIDIA's driver 0.5 MB.
    assert least_growth(open_and_close) < 7.0


@needs_statm
def test_asking_for_the_driver_does_not_grow_memory() -> None:
    """A context that is current in a thread that ends would stay, 2.5 MB each."""
    assert least_growth(driver_info) < 7.0


def test_two_renderers_at_once(rng: np.random.Generator, backend: str) -> None:
    scenes = [random_scene(rng, 60, degree) for degree in (1, 3)]
    cameras = [simple_camera(40 + 3 * i, 30 + i) for i in range(6)]
    with Renderer(scenes[0], backend) as first, Renderer(scenes[1], backend) as second:
        views = [
            (scene, renderer.render(camera, np.eye(4)))
            for camera in cameras
            for scene, renderer in zip(scenes, (first, second), strict=True)
        ]
        first.close()
        views.append((scenes[1], second.render(cameras[0], np.eye(4))))
    for scene, view in views:
        reference = composite(scene, view.camera, np.eye(4))
        np.testing.assert_allclose(view.rgb, reference.rgb, atol=1 / 255)
        np.testing.assert_allclose(view.opacity, reference.opacity, atol=1 / 255)


def test_the_same_view_is_the_same_picture(scene: GaussianScene, backend: str) -> None:
    """Whatever was rendered in between, and however many Gaussians it showed."""
    camera = simple_camera()
    with Renderer(scene, backend) as renderer:
        first = renderer.render(camera, np.eye(4))
        kept = first.rgb.copy()
        for i in range(6):
            renderer.render(simple_camera(20 + i, 20), np.eye(4))
        renderer.render(camera, FACING_AWAY)
        again = renderer.render(camera, np.eye(4))
    for name in ("rgb", "opacity", "depth", "depth_variance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    np.testing.assert_array_equal(first.rgb, kept)


def test_nothing_in_view_is_black_and_empty(scene: GaussianScene, backend: str) -> None:
    with Renderer(scene, backend) as renderer:
        renderer.render(simple_camera(), np.eye(4))
        view = renderer.render(simple_camera(), FACING_AWAY)
    for array in (view.rgb, view.opacity, view.depth, view.depth_variance):
        np.testing.assert_array_equal(array, 0.0)


def test_another_thread_may_take_over(scene: GaussianScene, backend: str) -> None:
    pictures: list[Any] = []
    with Renderer(scene, backend) as renderer:
        here = renderer.render(simple_camera(), np.eye(4))
        thread = threading.Thread(
            target=lambda: pictures.append(renderer.render(simple_camera(), np.eye(4)))
        )
        thread.start()
        thread.join()
        after = renderer.render(simple_camera(), np.eye(4))
    np.testing.assert_array_equal(pictures[0].rgb, here.rgb)
    np.testing.assert_array_equal(after.rgb, here.rgb)


def test_a_closed_renderer_says_so(scene: GaussianScene, backend: str) -> None:
    renderer = Renderer(scene, backend)
    renderer.close()
    renderer.close()
    with pytest.raises(RenderError, match="closed"):
        renderer.render(simple_camera(), np.eye(4))


def test_errors_leave_the_renderer_usable(
    scene: GaussianScene, rng: np.random.Generator, backend: str
) -> None:
    camera = simple_camera()
    bent = Camera.parse("SIMPLE_RADIAL,64,48,55,32,24,0.1")
    with Renderer(scene, backend) as renderer:
        before = renderer.render(camera, np.eye(4))
        with pytest.raises(RenderError, match="undistort"):
            renderer.render(bent, np.eye(4))
        for pose in (np.eye(3), 2.0 * np.eye(4), np.full((4, 4), np.nan)):
            with pytest.raises(PoseError, match="cam_from_world"):
                renderer.render(camera, pose)
        after = renderer.render(camera, np.eye(4))
    np.testing.assert_array_equal(after.rgb, before.rgb)


def test_a_picture_that_fills_the_memory_is_refused(scene: GaussianScene, backend: str) -> None:
    with Renderer(scene, backend) as renderer:
        for size in ((60_000, 60_000), (100_000_001, 1)):
            with pytest.raises(RenderError, match=f"100000000 pixels, not {size[0]}x{size[1]}"):
                renderer.render(simple_camera(*size), np.eye(4))
        assert renderer.render(simple_camera(), np.eye(4)).rgb.shape == (48, 64, 3)


def test_an_image_beyond_the_driver_is_refused(scene: GaussianScene) -> None:
    with (
        Renderer(scene, "gl") as renderer,
        pytest.raises(RenderError, match="10000000x1 is more than the driver's"),
    ):
        renderer.render(simple_camera(10_000_000, 1), np.eye(4))


def no_driver(*_: object, **__: object) -> None:
    raise Exception("libEGL.so.1 not loaded")


def test_no_opengl_names_the_remedy(scene: GaussianScene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(moderngl, "create_context", no_driver)
    for attempt in (lambda: Renderer(scene, "gl"), driver_info):
        with pytest.raises(RenderError, match=r"libEGL\.so\.1 not loaded.*install.*doctor"):
            attempt()


def test_without_opengl_the_cpu_renders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(moderngl, "create_context", no_driver)
    assert choose_backend() == "cpu"
    monkeypatch.setattr(cpu_rasterizer, "is_available", lambda: False)
    with pytest.raises(RenderError, match=r"libEGL.*gscpe\[cpu\]"):
        choose_backend()


def test_the_backend_follows_the_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    def driver(is_software: bool) -> DriverInfo:
        return DriverInfo("name", "vendor", "4.5", 450, is_software)

    for software, numba, expected in (
        (False, True, "gl"),
        (True, True, "cpu"),
        (True, False, "gl"),
    ):
        monkeypatch.setattr(rasterizer, "driver_info", partial(driver, software))
        monkeypatch.setattr(cpu_rasterizer, "is_available", lambda numba=numba: numba)
        assert choose_backend("auto") == expected
    with pytest.raises(SettingsError, match="auto, gl or cpu, not 'cuda'"):
        choose_backend("cuda")


def test_without_numba_the_remedy_is_named(
    scene: GaussianScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    for name in ("compiled", "cpu_projection", "cpu_compositing"):
        module = f"gscpe.render.{name}"
        monkeypatch.delitem(sys.modules, module, raising=False)
        monkeypatch.delattr(module, raising=False)
    assert not cpu_rasterizer.is_available()
    with pytest.raises(MissingDependencyError, match=r"pip install 'gscpe\[cpu\]'"):
        Renderer(scene, "cpu")


def test_threads_share_the_work_and_nothing_else(scene: GaussianScene) -> None:
    views = [
        CpuRasterizer(scene, threads=threads).render(simple_camera(70, 50), np.eye(4))
        for threads in (1, 2, 5)
    ]
    for view in views[1:]:
        np.testing.assert_array_equal(view.rgb, views[0].rgb)
        np.testing.assert_array_equal(view.depth_variance, views[0].depth_variance)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_forked_process_renders(scene: GaussianScene) -> None:
    """The parent's threads do not exist in the child, which must start its own."""
    with Renderer(scene, "cpu") as renderer:
        expected = renderer.render(simple_camera(), np.eye(4)).rgb
        context = multiprocessing.get_context("fork")
        pictures = context.SimpleQueue()
        child = context.Process(
            target=lambda: pictures.put(renderer.render(simple_camera(), np.eye(4)).rgb)
        )
        child.start()
        np.testing.assert_array_equal(pictures.get(), expected)
        child.join(timeout=60)
        assert child.exitcode == 0


def test_an_old_driver_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    released: list[bool] = []
    old = SimpleNamespace(
        version_code=210,
        info={"GL_VERSION": "2.1 Mesa 7.0"},
        release=lambda: released.append(True),
    )
    monkeypatch.setattr(moderngl, "create_context", lambda **_: old)
    with pytest.raises(RenderError, match=r"too old: 2\.1 Mesa 7\.0, 3\.3 is needed"):
        driver_info()
    assert released == [True]


def test_a_missing_shader_gives_the_context_back(
    scene: GaussianScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    contexts: list[Any] = []
    create = moderngl.create_context

    def remember(**options: Any) -> Any:
        contexts.append(create(**options))
        return contexts[-1]

    monkeypatch.setattr(moderngl, "create_context", remember)
    monkeypatch.setattr(shader_source, "_FOLDERS", ())
    with pytest.raises(RenderError, match=r"shader cover\.vert is missing.*install gscpe again"):
        Renderer(scene, "gl")
    assert len(contexts) == 1
    assert isinstance(contexts[0].mglo, moderngl.InvalidObject)


def test_the_driver_is_described(scene: GaussianScene) -> None:
    info = driver_info()
    assert info.version_code >= 330
    assert info.renderer
    assert info.version
    assert info.is_software == ("llvmpipe" in info.renderer.lower()) or sys.platform == "win32"
    with Renderer(scene, "gl") as renderer:
        assert info.renderer in renderer.description
