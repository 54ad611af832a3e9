# SPDX-License-Identifier: Apache-2.0
"""What a tracker is given: frames of all kinds, times, cameras, settings, and a localizer that
others use, too."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from moving_camera import CAMERA, WAITS, picture, pose, right, the_map

from gscpe import (
    Camera,
    Localizer,
    Tracker,
    TrackingResult,
    TrackingSettings,
    TrustSettings,
    map_without_references,
)
from gscpe.errors import (
    CameraError,
    ClosedError,
    InputError,
    MapError,
    PhotoError,
    PoseError,
    SettingsError,
)


def test_closed_in_the_middle_it_leaves_no_thread() -> None:
    map_ = the_map()  # whose progress bar leaves tqdm's own thread, if no test before had one
    before = set(threading.enumerate())
    tracker = Tracker(map_, matcher="sift")
    for index in range(3):
        tracker.track(picture(index), CAMERA)  # the localizer is at work
    tracker.close()
    tracker.close()
    assert set(threading.enumerate()) <= before
    with pytest.raises(ClosedError, match="this tracker is closed"):
        tracker.track(picture(3), CAMERA)


def test_two_trackers_share_a_localizer(localizer: Localizer) -> None:
    with Tracker(localizer, WAITS) as one, Tracker(localizer, WAITS) as other:
        assert one.localizer is other.localizer
        for index in range(4):
            right(one.track(picture(index), CAMERA), pose(index))
            right(other.track(picture(8 - index), CAMERA), pose(8 - index))
    right_again = localizer.localize(picture(0), CAMERA)  # it was not closed with them
    assert right_again.localized


def test_a_tracker_in_many_threads_takes_one_frame_at_a_time(tracker: Tracker) -> None:
    tracker.track(picture(0), CAMERA)
    results: list[TrackingResult] = []
    threads = [
        threading.Thread(target=lambda: results.append(tracker.track(picture(1), CAMERA)))
        for _ in range(6)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 6
    for result in results:
        right(result, pose(1))


def test_a_closed_localizer_is_named(localizer: Localizer) -> None:
    with Localizer(the_map(), matcher="sift") as other, Tracker(other, WAITS) as tracker:
        tracker.track(picture(0), CAMERA)
        other.close()
        with pytest.raises(ClosedError, match="closed"):
            for index in range(1, 40):
                tracker.track(picture(index), CAMERA)


def test_grey_and_transparent_and_distorted_frames(tracker: Tracker) -> None:
    tracker.track(picture(0), CAMERA)
    grey = np.asarray(np.rint(picture(1) @ np.array([0.299, 0.587, 0.114])), dtype=np.uint8)
    right(tracker.track(grey, CAMERA), pose(1))
    opaque = np.dstack([picture(2), np.full((180, 240), 255, dtype=np.uint8)])
    opaque[:, :60, 3] = 0
    opaque[:, :60, :3] = 200
    right(tracker.track(opaque, CAMERA), pose(2))


def test_smaller_frames_are_less_exact_and_say_so(localizer: Localizer) -> None:
    """120x90 pixels."""
    with Tracker(localizer, TrackingSettings(wait=True, scale=0.5)) as tracker:
        for index in range(4):
            result = tracker.track(picture(index), CAMERA)
            right(result, pose(index), 0.04, 0.5)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ((picture(0)[:100], CAMERA), CameraError, "its camera is 240x180"),
        ((picture(0).astype(float), CAMERA), PhotoError, "uint8"),
        ((picture(0), None), CameraError, "gscpe.Camera"),
        ((picture(0), CAMERA, np.nan), InputError, "finite"),
        ((picture(0), CAMERA, "now"), InputError, "finite"),
        ((picture(0), CAMERA, None, np.eye(4)), PoseError, "gscpe.Motion"),
        (("frame.png", CAMERA), PhotoError, "read_image"),
    ],
)
def test_what_cannot_be_a_frame(
    tracker: Tracker, arguments: tuple[object, ...], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        tracker.track(*arguments)  # type: ignore[arg-type]
    assert tracker.track(picture(0), CAMERA).status == "relocalized"  # it did not count


def test_frames_of_another_size_begin_anew(tracker: Tracker) -> None:
    tracker.track(picture(0), CAMERA)
    small = np.ascontiguousarray(picture(1)[::4, ::4])
    assert tracker.track(small, CAMERA.resized(60, 45)).status in {"lost", "relocalized"}
    results = [tracker.track(picture(2), CAMERA) for _ in range(3)]
    assert "relocalized" in [result.status for result in results]
    right(results[-1], pose(2))


def test_times_grow(tracker: Tracker) -> None:
    tracker.track(picture(0), CAMERA, time=10.0)
    tracker.track(picture(1), CAMERA, time=10.1)
    with pytest.raises(InputError, match="not later than the last"):
        tracker.track(picture(2), CAMERA, time=10.1)
    with pytest.raises(InputError, match="every frame, or with none"):
        tracker.track(picture(2), CAMERA)
    right(tracker.track(picture(2), CAMERA, time=10.2), pose(2))


def test_what_cannot_be_tracked_in() -> None:
    with pytest.raises(MapError, match="no reference photos"):
        Tracker(map_without_references(the_map().scene), matcher="sift")
    with pytest.raises(SettingsError, match="TrackingSettings"):
        Tracker(the_map(), settings=TrustSettings())  # type: ignore[arg-type]


def test_a_localizer_renders_and_matches_as_it_does(localizer: Localizer) -> None:
    with pytest.raises(SettingsError, match="leave backend and matcher out"):
        Tracker(localizer, backend="cpu")


@pytest.mark.parametrize(
    "wrong",
    [
        {"scale": 0.0},
        {"anchor_pixels": 50.0},
        {"levels": 0},
        {"anchors": 1},
        {"template_pixels": 10},
    ],
)
def test_settings_out_of_range(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError):
        TrackingSettings(**wrong)  # type: ignore[arg-type]


def test_another_camera_goes_on_in_the_same_map(tracker: Tracker) -> None:
    """A lens that zooms: the anchors are those of the camera before, for a while."""
    tracker.track(picture(0), CAMERA)
    cropped = Camera.pinhole(
        200, 150, fx=CAMERA.fx, fy=CAMERA.fy, cx=CAMERA.cx - 20, cy=CAMERA.cy - 15
    )
    result = tracker.track(picture(1)[15:165, 20:220].copy(), cropped)
    assert result.status == "tracking"
    right(result, pose(1))
