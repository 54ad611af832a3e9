# SPDX-License-Identifier: Apache-2.0
"""One localizer in many threads, as a web server has it, and several side by side."""

from __future__ import annotations

import functools
import threading
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import count
from typing import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera

from gscpe import LocalizationResult, Localizer
from gscpe.errors import ClosedError
from gscpe.geometry import se3
from gscpe.localization import Observer
from gscpe.mapping import map_from_rgbd
from gscpe.matching import make_matcher
from gscpe.render import RenderedView
from gscpe.scene import Map

CAMERA = room_camera()
CROPPED = replace(CAMERA, width=150, height=110)
STEPS = ([0.05, 0, 0.02, 0, 0.03, 0], [-0.06, 0.02, 0, 0.01, 0, 0.04])
PHOTOS = [
    (room().shoot(camera, se3.exp(step) @ ROOM_POSE).uint8, camera)
    for step, camera in zip(STEPS, (CAMERA, CROPPED), strict=True)
]
BLANK = np.full((120, 160, 3), 90, dtype=np.uint8)


@functools.cache
def small_map() -> Map:
    shot = room().shoot(CAMERA, ROOM_POSE)
    return map_from_rgbd(shot.uint8, shot.depth, CAMERA, ROOM_POSE)


@pytest.fixture
def localizer(backend: str) -> Iterator[Localizer]:
    with Localizer(small_map(), backend=backend) as localizer:
        yield localizer


def values(result: LocalizationResult) -> tuple[NDArray[np.float64], ...]:
    assert result.cam_from_world is not None, result.reason
    assert result.covariance is not None
    return result.cam_from_world, result.covariance


def assert_same(result: LocalizationResult, expected: LocalizationResult) -> None:
    for a, b in zip(values(result), values(expected), strict=True):
        np.testing.assert_array_equal(a, b)


def test_many_threads_get_the_poses_of_one(localizer: Localizer) -> None:
    """To the bit, with a camera estimated, views rendered and photos refused in between."""
    alone = [localizer.localize(*photo) for photo in PHOTOS]
    seen = localizer.render(CAMERA, ROOM_POSE).rgb
    estimated = localizer.estimate_camera(PHOTOS[0][0])
    with ThreadPoolExecutor(8) as pool:
        refused = pool.submit(localizer.localize, BLANK, CAMERA)
        cameras = pool.submit(localizer.estimate_camera, PHOTOS[0][0])
        rendered = [pool.submit(localizer.render, CAMERA, ROOM_POSE) for _ in range(6)]
        localized = [pool.submit(localizer.localize, *PHOTOS[i % 2]) for i in range(8)]
        tracked = [pool.submit(localizer.localize, *PHOTOS[i], alone[i]) for i in range(2)]
        for i, answer in enumerate(localized):
            assert_same(answer.result(), alone[i % 2])
        for view in rendered:
            np.testing.assert_array_equal(view.result().rgb, seen)
        assert cameras.result() == estimated
        assert not refused.result().localized
        assert all(answer.result().started_from == "tracking" for answer in tracked)


def test_closing_while_threads_localize(localizer: Localizer) -> None:
    alone = localizer.localize(*PHOTOS[0])
    under_way = threading.Barrier(5)

    def localize() -> int:
        for localized in count():
            if localized == 1:
                under_way.wait()
            try:
                assert_same(localizer.localize(*PHOTOS[0]), alone)
            except ClosedError:
                return localized
        raise AssertionError

    with ThreadPoolExecutor(4) as pool:
        futures = [pool.submit(localize) for _ in range(4)]
        under_way.wait()
        localizer.close()
        assert all(future.result() >= 1 for future in futures)


def test_a_closed_localizer_says_so(localizer: Localizer) -> None:
    """Whatever it is asked, also where it would not have come as far as rendering."""
    localizer.close()
    localizer.close()
    for attempt in (
        lambda: localizer.localize(BLANK, CAMERA),
        lambda: localizer.estimate_camera(BLANK),
        lambda: localizer.render(CAMERA, ROOM_POSE),
    ):
        with pytest.raises(ClosedError, match="this localizer is closed"):
            attempt()


def test_localizers_side_by_side_share_a_matcher(backend: str) -> None:
    matcher = make_matcher()

    def localize(_: int) -> list[LocalizationResult]:
        with Localizer(small_map(), matcher=matcher, backend=backend) as localizer:
            return [localizer.localize(*photo) for photo in PHOTOS]

    alone = localize(0)
    with ThreadPoolExecutor(2) as pool:
        for results in pool.map(localize, range(2)):
            for result, expected in zip(results, alone, strict=True):
                assert_same(result, expected)


def test_an_observer_may_render(localizer: Localizer) -> None:
    """It is called while the localizer works: it must not wait for itself."""

    class Looks(Observer):
        seen: tuple[RenderedView, ...] = ()

        def anchor_rendered(self, view: RenderedView) -> None:
            self.seen = (*self.seen, localizer.render(view.camera, ROOM_POSE))

    looks = Looks()
    assert localizer.localize(*PHOTOS[0], observer=looks).localized
    assert looks.seen


@pytest.mark.parametrize("backend", ["gl"])
def test_a_web_server(localizer: Localizer) -> None:
    """A thread for each request, none of which made the localizer; 503 once it is closed."""
    alone = localizer.localize(*PHOTOS[0]).cam_from_world

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            photo = np.frombuffer(body, dtype=np.uint8).reshape(BLANK.shape)
            try:
                status, answer = 200, values(localizer.localize(photo, CAMERA))[0].tobytes()
            except ClosedError as error:
                status, answer = 503, str(error).encode()
            self.send_response(status)
            self.send_header("Content-Length", str(len(answer)))
            self.end_headers()
            self.wfile.write(answer)

        def log_message(self, *_: object) -> None:
            pass

    def ask(_: int) -> NDArray[np.float64]:
        url = f"http://127.0.0.1:{server.server_port}/"
        request = urllib.request.Request(url, PHOTOS[0][0].tobytes(), method="POST")
        with urllib.request.urlopen(request, timeout=120) as answer:
            return np.frombuffer(answer.read()).reshape(4, 4)

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            with ThreadPoolExecutor(4) as pool:
                for pose in pool.map(ask, range(4)):
                    np.testing.assert_array_equal(pose, alone)
            localizer.close()
            with pytest.raises(urllib.error.HTTPError, match="503"):
                ask(0)
        finally:
            server.shutdown()
            thread.join()
