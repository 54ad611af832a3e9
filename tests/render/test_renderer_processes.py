# SPDX-License-Identifier: Apache-2.0
"""Renderers in threads and processes, many of them, and drivers that fail under way."""

from __future__ import annotations

import gc
import multiprocessing
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import moderngl
import numpy as np
import pytest
from helpers import random_scene, simple_camera
from numpy.typing import NDArray

from gscpe.errors import RenderError
from gscpe.render import Renderer
from gscpe.render.context import check_errors
from gscpe.render.gl_rasterizer import GlRasterizer
from gscpe.splats import GaussianScene

if TYPE_CHECKING:
    from multiprocessing.context import ForkContext, SpawnContext

needs_proc = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="there is no /proc")
needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")


@pytest.fixture
def scene(rng: np.random.Generator) -> GaussianScene:
    return random_scene(rng, 300, 1)


def picture(scene: GaussianScene, backend: str) -> Any:
    with Renderer(scene, backend) as renderer:
        return renderer.render(simple_camera(), np.eye(4)).rgb


def put_picture(pictures: Any, scene: GaussianScene, backend: str) -> None:
    """What a worker does: the picture, or why there is none."""
    try:
        pictures.put(picture(scene, backend))
    except RenderError as error:
        pictures.put(str(error))


def from_worker(
    context: ForkContext | SpawnContext, scene: GaussianScene, backend: str
) -> NDArray[np.float32] | str:
    """The picture, or why there is none."""
    pictures = context.Queue()
    worker = context.Process(target=put_picture, args=(pictures, scene, backend))
    worker.start()
    try:
        answer: NDArray[np.float32] | str = pictures.get(timeout=120)
        return answer
    finally:
        worker.join(timeout=60)
        if worker.is_alive():
            worker.kill()


def test_a_renderer_may_live_in_another_thread(scene: GaussianScene, backend: str) -> None:
    """Made, used and closed there."""
    expected = picture(scene, backend)
    with ThreadPoolExecutor(1) as pool:
        np.testing.assert_array_equal(pool.submit(picture, scene, backend).result(), expected)


def test_a_renderer_for_each_thread(scene: GaussianScene, backend: str) -> None:
    expected = picture(scene, backend)
    with ThreadPoolExecutor(4) as pool:
        for seen in pool.map(lambda _: picture(scene, backend), range(8)):
            np.testing.assert_array_equal(seen, expected)


def test_a_spawned_process_renders(scene: GaussianScene, backend: str) -> None:
    expected = picture(scene, backend)
    np.testing.assert_array_equal(
        from_worker(multiprocessing.get_context("spawn"), scene, backend), expected
    )


@needs_fork
def test_a_forked_process_is_told_that_opengl_did_not_survive(scene: GaussianScene) -> None:
    """Rather than wait for ever for the driver's threads."""
    picture(scene, "gl")
    assert "spawn" in from_worker(multiprocessing.get_context("fork"), scene, "gl")


@needs_fork
def test_a_forked_process_cannot_use_its_parents_renderer(scene: GaussianScene) -> None:
    with Renderer(scene, "gl") as renderer:
        before = renderer.render(simple_camera(), np.eye(4)).rgb

        def render(answers: Any) -> None:
            try:
                with renderer:
                    renderer.render(simple_camera(), np.eye(4))
            except RenderError as error:
                answers.put(str(error))

        context = multiprocessing.get_context("fork")
        answers = context.Queue()
        worker = context.Process(target=render, args=(answers,))
        worker.start()
        assert "forked" in answers.get(timeout=60)
        worker.join(timeout=60)
        assert worker.exitcode == 0  # closed there without a call to the driver
        after = renderer.render(simple_camera(), np.eye(4)).rgb
    np.testing.assert_array_equal(after, before)


@needs_proc
def test_fifty_renderers_leave_nothing_behind(scene: GaussianScene, backend: str) -> None:
    """No file and no thread; the driver keeps some of its own from the first to the last."""
    picture(scene, backend)
    gc.collect()
    files, threads = len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))
    for _ in range(50):
        picture(scene, backend)
    gc.collect()
    assert len(os.listdir("/proc/self/fd")) <= files + 2
    assert len(os.listdir("/proc/self/task")) <= threads + 2
    assert threading.active_count() <= threads


def test_a_driver_without_memory_says_so(
    scene: GaussianScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the renderer goes on with smaller images."""
    with Renderer(scene, "gl") as renderer:
        before = renderer.render(simple_camera(), np.eye(4)).rgb
        with monkeypatch.context() as patched:
            patched.setattr(
                moderngl.Context, "error", property(lambda _: "GL_OUT_OF_MEMORY"), raising=True
            )
            with pytest.raises(
                RenderError, match=r"OUT_OF_MEMORY.*(texture|image) of 80x70.*smaller"
            ):
                renderer.render(simple_camera(80, 70), np.eye(4))
        after = renderer.render(simple_camera(), np.eye(4)).rgb
        again = renderer.render(simple_camera(80, 70), np.eye(4)).rgb
    np.testing.assert_array_equal(after, before)
    assert again.shape == (70, 80, 3)


def test_a_splat_beyond_the_drivers_memory(
    scene: GaussianScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(moderngl.Context, "error", property(lambda _: "GL_OUT_OF_MEMORY"))
    with pytest.raises(RenderError, match=r"OUT_OF_MEMORY while allocating.*smaller splat"):
        Renderer(scene, "gl")


def test_a_framebuffer_that_the_driver_refuses(
    scene: GaussianScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise moderngl.Error("the framebuffer is not complete (UNSUPPORTED)")

    blending = GlRasterizer(scene, gpu_sort=False)
    blending.render(simple_camera(), np.eye(4))
    monkeypatch.setattr(moderngl.Context, "framebuffer", refuse)
    with pytest.raises(RenderError, match=r"failed to render: the framebuffer.*\("):
        blending.render(simple_camera(20, 20), np.eye(4))
    blending.render(simple_camera(), np.eye(4))
    blending.close()
    with pytest.raises(RenderError, match="failed to set up: the framebuffer"):
        Renderer(scene, "gl")


def test_a_lost_context_names_the_driver() -> None:
    lost: Any = SimpleNamespace(error="GL_CONTEXT_LOST", info={"GL_RENDERER": "Some GPU"})
    with pytest.raises(RenderError, match=r"GL_CONTEXT_LOST while rendering \(Some GPU\)"):
        check_errors(lost, "rendering")
