# SPDX-License-Identifier: Apache-2.0
"""One renderer in many threads: right pictures, and an error, not a crash, once it is closed."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from typing import Any

import numpy as np
import pytest
from helpers import random_scene, simple_camera

from gscpe.errors import ClosedError, RenderError
from gscpe.geometry import se3
from gscpe.render import RenderedView, Renderer, driver_info
from gscpe.render.context import create_context
from gscpe.splats import GaussianScene

THREADS = 8
CAMERAS = [simple_camera(60 + 7 * i, 50 + 3 * i) for i in range(6)]
POSES = [se3.exp([0.05 * i, -0.03 * i, 0.1 * i, 0.02 * i, 0.01 * i, 0.3 * i]) for i in range(6)]


@pytest.fixture
def scene(rng: np.random.Generator) -> GaussianScene:
    """Large enough that the CPU rasterizer cuts it into several tasks."""
    return random_scene(rng, 20_000, 1, scale=(0.005, 0.02))


def same(a: RenderedView, b: RenderedView) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("rgb", "opacity", "depth", "depth_variance", "cam_from_world")
    )


def test_many_threads_get_the_pictures_of_one(scene: GaussianScene, backend: str) -> None:
    views = list(zip(CAMERAS, POSES, strict=True))
    with Renderer(scene, backend) as renderer:
        alone = [renderer.render(*view) for view in views]
        together = threading.Barrier(THREADS)

        def render(first: int) -> list[bool]:
            together.wait()
            chosen = [(first + i) % len(views) for i in range(2 * len(views))]
            return [same(renderer.render(*views[i]), alone[i]) for i in chosen]

        with ThreadPoolExecutor(THREADS) as pool:
            for right in pool.map(render, range(THREADS)):
                assert all(right)
    assert not same(alone[0], alone[1])


def test_closing_while_threads_render(scene: GaussianScene, backend: str) -> None:
    """Each picture that was begun is finished; whoever comes after is told."""
    renderer = Renderer(scene, backend)
    alone = renderer.render(CAMERAS[0], POSES[0])
    under_way = threading.Barrier(THREADS + 1)

    def render() -> int:
        for rendered in count():
            if rendered == 1:
                under_way.wait()
            try:
                assert same(renderer.render(CAMERAS[0], POSES[0]), alone)
            except ClosedError:
                return rendered
        raise AssertionError

    with ThreadPoolExecutor(THREADS) as pool:
        futures = [pool.submit(render) for _ in range(THREADS)]
        under_way.wait()
        renderer.close()
        renderer.close()
        assert all(future.result() >= 1 for future in futures)


def test_an_error_in_one_thread_is_that_threads(scene: GaussianScene, backend: str) -> None:
    with Renderer(scene, backend) as renderer, ThreadPoolExecutor(4) as pool:
        right = renderer.render(CAMERAS[0], POSES[0])
        cameras = [CAMERAS[0], simple_camera(10_000_000, 10_000_000)] * 4
        answers = [pool.submit(renderer.render, camera, POSES[0]) for camera in cameras]
        for i, answer in enumerate(answers):
            if i % 2:
                assert isinstance(answer.exception(), RenderError)
            else:
                assert same(answer.result(), right)


def test_the_callers_own_context_stays_current(scene: GaussianScene) -> None:
    """A viewer, say, that draws with OpenGL in the thread that localizes."""
    theirs: Any = create_context()
    with theirs:
        texture = theirs.texture((2, 1), 1, b"ab", alignment=1)
        with Renderer(scene, "gl") as renderer:
            renderer.render(CAMERAS[0], POSES[0])
            driver_info()
            assert texture.read(alignment=1) == b"ab"
        assert texture.read(alignment=1) == b"ab"
        assert theirs.error == "GL_NO_ERROR"
        texture.release()
    theirs.release()
