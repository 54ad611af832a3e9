# SPDX-License-Identifier: Apache-2.0
"""The small functions of a service."""

from __future__ import annotations

import asyncio
import contextlib
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from serving import png_bomb

from gscpe.errors import (
    CameraError,
    GscpeError,
    InputError,
    MapError,
    PhotoError,
    PoseError,
    SettingsError,
)
from gscpe.geometry import Camera
from gscpe.service import access, forms
from gscpe.service.following import FrameJob, FrameTimes, LatestFrame
from gscpe.service.gate import Gate
from gscpe.service.limits import Limits, check_photo
from gscpe.service.metrics import Metrics
from gscpe.service.pages import front_page
from gscpe.service.problem import ProblemError, one_line, problem_of

SMALL = Limits(pixels=100 * 100)


def encoded(ending: str, width: int = 40, height: int = 30) -> bytes:
    return bytes(cv2.imencode(ending, np.full((height, width, 3), 90, np.uint8))[1])


def test_photos_are_judged_by_their_headers() -> None:
    for ending in (".jpg", ".png", ".webp"):
        assert check_photo(encoded(ending), "a", SMALL) == (40, 30)
    for bomb in (png_bomb(200, 200), png_bomb(60_000, 60_000), encoded(".jpg", 101, 100)):
        with pytest.raises(ProblemError) as caught:
            check_photo(bomb, "a.png", SMALL)
        assert caught.value.problem.status == 413
    for data in (b"", b"GIF89a", encoded(".tiff"), encoded(".bmp"), b"\xff\xd8\xff", b"x" * 1000):
        with pytest.raises(PhotoError, match=r"^a\.jpg is not an image that can be decoded; exp"):
            check_photo(data, "a.jpg", SMALL)


@given(st.binary(max_size=200), st.sampled_from([".jpg", ".png", ".webp"]), st.integers(0, 150))
def test_spoilt_headers(noise: bytes, ending: str, at: int) -> None:
    data = encoded(ending)
    with contextlib.suppress(PhotoError, ProblemError):
        check_photo(data[:at] + noise + data[at + len(noise) :], "a", SMALL)


def test_settings_out_of_range() -> None:
    with pytest.raises(SettingsError, match="pixels must be"):
        Limits(pixels=0)
    with pytest.raises(SettingsError, match="trackers"):
        Limits(trackers=-1)


def test_problems_use_the_words_of_errors_and_tell_nothing_else() -> None:
    known = problem_of(CameraError("the camera\n is 3x4"))
    assert known.as_json() == {
        "type": "https://github.com/gscpe/gscpe/blob/main/docs/serving.md#errors",
        "title": "The camera cannot be used",
        "status": 422,
        "detail": "the camera is 3x4",
        "error": "CameraError",
    }
    for error in (MapError("/secret"), OSError("/secret"), ValueError("/secret"), GscpeError("/")):
        own = problem_of(error)
        assert own.status == 500
        assert "/" not in own.detail


@given(st.text(max_size=2000))
def test_one_line_is_one_printable_line(text: str) -> None:
    line = one_line(text)
    assert len(line) <= 500
    assert line == "" or line.isprintable()


def test_the_gate() -> None:
    gate = Gate(1, "full", lambda: 2.2)
    with gate.passed(), pytest.raises(ProblemError) as caught, gate.passed():
        pass
    assert caught.value.problem.status == 503
    assert caught.value.problem.headers() == {"Retry-After": "3"}
    assert gate.inside == 0
    with gate.passed():
        pass


def test_tokens(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text("  0123456789abcdef\n")
    token = access.read_token(file)
    assert token == "0123456789abcdef"
    assert access.bears("Bearer 0123456789abcdef", token)
    assert access.bears("bearer  0123456789abcdef", token)
    for wrong in (None, "", token, f"Basic {token}", "Bearer", "Bearer é", f"Bearer {token}x"):
        assert not access.bears(wrong, token)
    for text in ("short", "", "two words are too many", "ünïcödé-lettersss"):
        file.write_text(text)
        with pytest.raises(SettingsError, match="must hold one word"):
            access.read_token(file)
    with pytest.raises(SettingsError, match="cannot be read: No such file"):
        access.read_token(tmp_path / "missing")


def test_who_may_reach_it() -> None:
    for host in ("127.0.0.1", "localhost", "::1", "[::1]", "127.8.8.8"):
        access.check_exposure(host, None, False)
    for host in ("0.0.0.0", "::", "192.168.1.2", "example.org", ""):
        access.check_exposure(host, "token", False)
        access.check_exposure(host, None, True)
        with pytest.raises(SettingsError, match="--token-file"):
            access.check_exposure(host, None, False)


def test_other_pages_and_other_names() -> None:
    for header in ("localhost:8000", "127.0.0.1", "[::1]:8000", "LOCALHOST"):
        assert access.is_own_host(header, "127.0.0.1")
    for header in ("evil.example:8000", "", "127.0.0.1.evil.example", "[", "localhost.evil"):
        assert not access.is_own_host(header, "127.0.0.1")
    assert access.is_own_page(None, "localhost:8000")
    assert access.is_own_page("http://localhost:8000", "localhost:8000")
    for origin in ("http://evil.example", "null", "http://localhost:9000", "file://"):
        assert not access.is_own_page(origin, "localhost:8000")


def test_cameras() -> None:
    camera = Camera.parse("PINHOLE,640,480,525.5,525.5,320,240")
    as_json = {"model": "pinhole", "width": 640, "height": 480, "params": [525.5, 525.5, 320, 240]}
    assert forms.parse_camera("PINHOLE,640,480,525.5,525.5,320,240") == camera
    assert forms.parse_camera(json.dumps(as_json)) == camera
    assert forms.parse_camera(" ") is forms.parse_camera(None) is None
    for wrong in ("{", "{}", '{"model": 1}', "PINHOLE", "[]", "x" * 5000, "PINHOLE 1e9 1 1 1 1 1"):
        with pytest.raises(CameraError):
            forms.parse_camera(wrong)
    for spoilt in (
        {"params": "1234"},
        {"params": {"0": 1}},
        {"params": [525.5, True, 320, 240]},
        {"params": [float("nan"), 525.5, 320, 240]},
        {"params": [1e-9, 525.5, 320, 240]},
        {"params": [525.5, 525.5, 1e18, 240]},
        {"width": 640.5},
        {"width": True},
        {"width": "640,480"},
        {"width": 10**400},
        {"model": {"a": 1}},
        {"model": "PINHOLE,640"},
    ):
        with pytest.raises(CameraError):
            forms.parse_camera(json.dumps(as_json | spoilt))


def test_priors() -> None:
    prior = forms.parse_prior("1 0 0 0 1 2 3", "0.5 20")
    assert prior is not None
    assert (prior.translation_sigma, prior.rotation_sigma_degrees) == (0.5, 20.0)
    again = forms.parse_prior(json.dumps(prior.cam_from_world.tolist()), None)
    assert again is not None
    np.testing.assert_array_equal(again.cam_from_world, prior.cam_from_world)
    assert forms.parse_prior("", "") is None
    for pose, sigma in (
        ("", "1 1"),
        ("1 0 0", ""),
        ("[[1]]", ""),
        ("[[[", ""),
        ("1 0 0 0 0 0 0", "1"),
        ("1 0 0 0 0 0 0", "nan 1"),
        ("1 0 0 0 0 0 0", "0 1"),
        ("0 0 0 0 0 0 0", ""),
    ):
        with pytest.raises(PoseError):
            forms.parse_prior(pose, sigma)


@given(st.text(max_size=300))
def test_any_text_at_all(text: str) -> None:
    for parse in (forms.parse_camera, lambda t: forms.parse_prior(t, None), forms.photo_name):
        with contextlib.suppress(CameraError, PoseError):
            parse(text)


def test_names_of_photos() -> None:
    assert forms.photo_name("C:\\photos\\a.jpg") == "a.jpg"
    assert forms.photo_name("../../etc/passwd") == "passwd"
    assert forms.photo_name("a\nb.jpg") == "a b.jpg"
    assert forms.photo_name(None) == forms.photo_name("/") == "the photo"


def test_metrics_are_prometheus_text() -> None:
    metrics = Metrics()
    assert metrics.mean_seconds() == 1.0
    metrics.request("/v1/maps", 200)
    metrics.photo('a"b\\', "localized", 0.3)
    metrics.photo('a"b\\', "localized", 3.0)
    metrics.frame("a", "lost")
    text = metrics.text({"gscpe_jobs_waiting": ("Jobs.", 3)})
    lines = text.splitlines()
    assert 'gscpe_requests_total{route="/v1/maps",status="200"} 1' in lines
    assert 'gscpe_photos_total{map="a\\"b\\\\",status="localized"} 2' in lines
    assert 'gscpe_photo_seconds_bucket{le="0.5"} 1' in lines
    assert 'gscpe_photo_seconds_bucket{le="+Inf"} 2' in lines
    assert "gscpe_photo_seconds_count 2" in lines
    assert "gscpe_jobs_waiting 3" in lines
    assert text.endswith("\n")
    assert metrics.mean_seconds() == pytest.approx(1.65)


def test_only_the_newest_frame_is_kept() -> None:
    async def play() -> list[Any]:
        latest = LatestFrame()
        for number in range(3):
            latest.put(FrameJob(number, b"", 0.0))
        taken = [await latest.take()]
        latest.put(FrameJob(3, b"", 0.0))
        latest.end()
        taken += [await latest.take(), await latest.take()]
        return [frame and frame.number for frame in taken] + [latest.lost]

    assert asyncio.run(play()) == [2, 3, None, 2]


def test_times_of_frames() -> None:
    given, came = FrameTimes(), FrameTimes()
    assert [given.time_of(1.0), given.time_of(2.5)] == [1.0, 2.5]
    for wrong in (2.5, 1.0, float("nan"), None):
        with pytest.raises(InputError):
            given.time_of(wrong)
    times = [came.time_of(None) for _ in range(100)]
    assert times == sorted(set(times))


def test_the_page_holds_all_that_it_needs() -> None:
    page = front_page()
    assert "/*STYLE*/" not in page.html
    assert "/*SCRIPT*/" not in page.html
    assert "http://" not in page.html.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in page.html
    assert "default-src 'none'" in page.policy
