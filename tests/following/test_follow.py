# SPDX-License-Identifier: Apache-2.0
"""Frames given to a tracker, and the files of what it answers; the tracker is made up here."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Iterator, Sequence

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import Localizer
from gscpe.datasets.tum import Trajectory
from gscpe.errors import OutputError, SequenceError, SettingsError
from gscpe.following import Odometry, Overlay, Tally, TrackFiles, follow
from gscpe.geometry import Camera, se3
from gscpe.poses import read_pose_file
from gscpe.sequences import Clock, Frame, Frames
from gscpe.tracking import Motion, TrackingResult

CAMERA = Camera.pinhole(8, 6, fx=8, fy=8, cx=4, cy=3)


def pose_at(time: float) -> NDArray[np.float64]:
    return se3.exp([time, 0, 0, 0, 0.1 * time, 0])


class Made(Frames):
    """A frame of each of these times, ten times as bright; those listed cannot be read."""

    description = "made"

    def __init__(self, times: Sequence[float], damaged: Sequence[float] = ()) -> None:
        self.times, self.damaged = times, damaged
        self.length = len(times)

    def __iter__(self) -> Iterator[Frame]:
        for time in self.times:
            image = np.full((6, 8, 3), 10 * time, dtype=np.uint8)
            bad = time in self.damaged
            name, stamp = f"frame {time}.png", str(time)
            trouble = "it is damaged" if bad else None
            yield Frame(name, time, None if bad else image, CAMERA, trouble, stamp)


class FakeTracker:
    """Finds the camera at the first frame, follows it, and loses it at those listed."""

    def __init__(self, lost: Sequence[float] = (), clock: FakeClock | None = None) -> None:
        self.lost, self.clock = lost, clock
        self.motions: list[Motion | None] = []

    def track(
        self,
        image: NDArray[np.uint8],
        camera: Camera,
        time: float | None = None,
        motion: Motion | None = None,
    ) -> TrackingResult:
        assert time is not None
        assert image[0, 0, 0] == int(10 * time) and camera == CAMERA
        if self.clock is not None:
            self.clock.seconds += 2.5
        if time in self.lost:
            return TrackingResult("lost", "it is dark", None, None, None, float("nan"), 1.0)
        found = "tracking" if self.motions else "relocalized"
        self.motions.append(motion)
        return TrackingResult(found, None, pose_at(time), np.eye(6), 3, 0.9, 1.5)  # type: ignore[arg-type]


class FakeClock(Clock):
    """Time that passes where somebody waits, or works."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def now(self) -> float:
        return self.seconds

    def wait(self, seconds: float) -> None:
        self.seconds += seconds


def test_files(tmp_path: Path) -> None:
    """Frames without a pose are in the details alone."""
    paths = [tmp_path / "new" / name for name in ("t.tum", "p.txt", "d.jsonl")]
    tally = Tally()
    with TrackFiles(*paths) as files:
        follow(FakeTracker(lost=[2]), Made([0, 1, 2, 3, 4], damaged=[3]), tally, [files])
    assert tally.counts == {"tracking": 2, "relocalized": 1, "lost": 1, "failed": 1}
    assert (tally.frames, tally.posed, tally.dropped, len(tally.seconds)) == (5, 3, 0, 4)
    text = "5 frames: 2 tracked, 1 relocalized, 1 lost, 0 dropped, 1 unreadable; "
    assert str(tally).startswith(text)

    trajectory, poses, details = (read_pose_file(path) for path in paths)
    assert (trajectory.format, poses.format) == ("tum", "hloc")
    assert list(trajectory.poses) == ["0", "1", "4"]
    assert list(poses.poses) == list(details.poses) == [f"frame {i}.png" for i in (0, 1, 4)]
    for file in (trajectory, poses, details):
        for time, pose in zip((0, 1, 4), file.poses.values(), strict=True):
            np.testing.assert_allclose(pose, pose_at(time), atol=1e-9)
    lines = [json.loads(line) for line in paths[2].read_text().splitlines()]
    status = ["relocalized", "tracking", "lost", "failed", "tracking"]
    assert [line["status"] for line in lines] == status
    reasons = [None, None, "it is dark", "it is damaged", None]
    assert [line["reason"] for line in lines] == reasons
    assert [line["time"] for line in lines] == [0, 1, 2, 3, 4]
    assert lines[2]["agreement"] is None and lines[1]["agreement"] == 0.9
    assert (lines[1]["covariance"], lines[1]["anchor_age"]) == (np.eye(6).tolist(), 3)
    assert lines[1]["milliseconds"] == 1.5


def test_earlier_files_are_kept(tmp_path: Path) -> None:
    for _ in range(2):
        with TrackFiles(tmp_path / "t.tum", None, None) as files:
            follow(FakeTracker(), Made([0, 1]), Tally(), [files])
        (tmp_path / "t.tum").open("a").write("# mine\n")
    assert (tmp_path / "t.tum.bak").read_text().endswith("# mine\n")
    with pytest.raises(OutputError, match="cannot be written"):
        TrackFiles(tmp_path / "ok.tum", tmp_path / "t.tum" / "p.txt", None)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_names_the_file() -> None:
    """Also where the line is still in a buffer when the file is closed."""
    files = TrackFiles("/dev/full", None, None)
    files._trajectory.reconfigure(line_buffering=False)  # type: ignore[attr-defined]
    files._trajectory.write("0 0 0 0 0 0 0 1")
    with pytest.raises(OutputError, match="/dev/full cannot be written: No space"):
        files.close()


def test_lines_are_there_at_once(tmp_path: Path) -> None:
    """Whoever kills the program finds all frames before."""
    seen = []

    class Looks:
        def add(self, frame: Frame, result: TrackingResult | None) -> None:
            seen.append(len((tmp_path / "t.tum").read_text().splitlines()))

    with TrackFiles(tmp_path / "t.tum", None, tmp_path / "d.jsonl") as files:
        follow(FakeTracker(), Made([0, 1, 2]), Tally(), [files, Looks()])
    assert seen == [1, 2, 3]


def test_an_interrupt_leaves_whole_lines(tmp_path: Path) -> None:
    class Interrupting(FakeTracker):
        def track(
            self,
            image: NDArray[np.uint8],
            camera: Camera,
            time: float | None = None,
            motion: Motion | None = None,
        ) -> TrackingResult:
            if time == 2:
                signal.raise_signal(signal.SIGINT)
            return super().track(image, camera, time, motion)

    tally = Tally()
    with (
        pytest.raises(KeyboardInterrupt),
        TrackFiles(tmp_path / "t.tum", None, tmp_path / "d.jsonl") as files,
    ):
        follow(Interrupting(), Made(range(100)), tally, [files])
    assert tally.frames == 2
    for name in ("t.tum", "d.jsonl"):
        assert len((tmp_path / name).read_text().splitlines()) == 2


def test_an_error_of_the_source_comes_after_its_frames() -> None:
    class Ends(Made):
        def __iter__(self) -> Iterator[Frame]:
            yield from super().__iter__()
            raise SequenceError("time does not run forward")

    tally = Tally()
    with pytest.raises(SequenceError, match="forward"):
        follow(FakeTracker(), Ends([0, 1, 2]), tally, [])
    assert tally.posed == 3


def test_in_real_time_frames_are_dropped() -> None:
    """2.5 s of work a frame, and a frame a second: while it works, two or three come, and the
    newest is taken."""
    clock, tally = FakeClock(), Tally()
    tracker = FakeTracker(clock=clock)
    follow(tracker, Made(range(11)), tally, [], real_time=True, clock=clock)
    assert (tally.frames, tally.dropped) == (5, 6)
    tally = Tally()
    follow(FakeTracker(), Made(range(11)), tally, [])
    assert (tally.frames, tally.dropped) == (11, 0)


def test_odometry_between_the_frames_that_are_seen() -> None:
    """Also across a frame that was lost, but not across one that could not be read at all."""
    times = np.arange(0.0, 4.01, 0.5)
    trajectory = Trajectory(times, np.stack([se3.inverse(pose_at(time)) for time in times]))
    tracker, tally = FakeTracker(lost=[2]), Tally()
    made = Made([0, 1, 2, 3, 4, 6], damaged=[3])
    follow(tracker, made, tally, [], Odometry(trajectory))
    first, one, four, six = tracker.motions
    assert first is None and six is None
    assert tally.without_odometry == 1
    for motion, before, now in ((one, 0, 1), (four, 2, 4)):
        assert motion is not None
        expected = pose_at(now) @ se3.inverse(pose_at(before))
        np.testing.assert_allclose(motion.cam_from_previous_cam, expected, atol=1e-9)

    class Timeless(Made):
        def __iter__(self) -> Iterator[Frame]:
            yield Frame("a.png", None, np.zeros((6, 8, 3), np.uint8), CAMERA)

    with pytest.raises(SettingsError, match=r"a\.png has no time.*--rate"):
        follow(FakeTracker(), Timeless([0]), Tally(), [], Odometry(trajectory))


class Filmed(Frames):
    """The room, filmed in four frames; live or not."""

    description = "room"

    def __init__(self, live: bool) -> None:
        self.live = live
        self.camera = room_camera(240, 180)
        self.times_read = 0

    def __iter__(self) -> Iterator[Frame]:
        self.times_read += 1
        assert not (self.live and self.times_read > 1), "it is gone"
        for number in range(4):
            image = room().shoot(self.camera, ROOM_POSE).uint8
            yield Frame(f"{number}", number / 10, image, self.camera)


@pytest.mark.parametrize("live", [False, True])
def test_the_overlay(live: bool, tmp_path: Path) -> None:
    """Photo, render and difference; where the camera is lost, no render. Live frames are kept
    meanwhile."""
    path = tmp_path / "new" / "overlay.avi"
    path.parent.mkdir()
    with Localizer(room_map(), matcher="sift") as localizer:
        with Overlay(path, localizer, Filmed(live)) as overlay:
            for frame in overlay.frames:
                found = TrackingResult("tracking", None, ROOM_POSE, None, 0, 0.9, 1.0)
                lost = TrackingResult("lost", "it is dark", None, None, None, 0.0, 1.0)
                if frame.name != "1":  # as if it had been dropped
                    overlay.add(frame, lost if frame.name == "2" else found)
            overlay.write()
        with pytest.raises(OutputError, match="does not end like a video"):
            Overlay(tmp_path / "overlay.gif", localizer, Filmed(False))
        assert [file.name for file in path.parent.iterdir()] == ["overlay.avi"]
    video = cv2.VideoCapture(str(path))
    pictures = []
    while (read := video.read())[0]:
        pictures.append(np.asarray(read[1])[24:, :, ::-1].astype(int))
    assert len(pictures) == 3
    photo, render, difference = np.split(pictures[0], 3, axis=1)
    assert photo.std() > 15
    assert np.abs(photo - render).mean() < 12
    assert difference.mean() < 40
    lost_photo, lost_render, _ = np.split(pictures[1], 3, axis=1)
    assert np.abs(lost_photo - photo).mean() < 5
    assert lost_render.std(axis=(0, 1)).max() < 5
