# SPDX-License-Identifier: Apache-2.0
"""Frames of video files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gscpe.errors import CameraError, SequenceError
from gscpe.geometry import Camera
from gscpe.sequences import OpenedVideo, open_frames

CAMERA = Camera.pinhole(160, 120, fx=150, fy=150, cx=80, cy=60)


def write_video(path: Path, count: int = 12, size: tuple[int, int] = (160, 120)) -> Path:
    """Frame i is of the brightness 20 i, with a red stripe to the left."""
    fourcc = cv2.VideoWriter.fourcc(*("MJPG" if path.suffix == ".avi" else "mp4v"))
    writer = cv2.VideoWriter(str(path), fourcc, 12.0, size)
    assert writer.isOpened()
    for number in range(count):
        frame = np.full((size[1], size[0], 3), 20 * number % 240, dtype=np.uint8)
        frame[:, :40] = (0, 0, 250)
        writer.write(frame)
    writer.release()
    return path


@pytest.mark.parametrize("ending", ["avi", "mp4"])
def test_names_times_and_colours(ending: str, tmp_path: Path) -> None:
    frames = open_frames(write_video(tmp_path / f"walk.{ending}"), CAMERA)
    assert frames.length == 12
    for _ in range(2):
        read = list(frames)
        assert [frame.name for frame in read] == [f"walk/{i:06d}.jpg" for i in range(12)]
        assert [frame.time for frame in read] == pytest.approx(
            [i / 12 for i in range(12)], abs=1e-6
        )
        for number, frame in enumerate(read):
            assert frame.image is not None
            assert frame.image[60, 20, 0] > 200, "red"
            assert frame.image[60, 20, 2] < 60
            assert abs(int(frame.image[60, 120, 0]) - 20 * number) < 6
        assert frames.trouble is None


def test_a_camera_of_another_size(tmp_path: Path) -> None:
    path = write_video(tmp_path / "walk.avi", 2)
    assert {frame.camera for frame in open_frames(path, CAMERA.resized(320, 240))} == {CAMERA}
    with pytest.raises(CameraError, match=r"walk\.avi is 160x120, but its camera is 160x100"):
        open_frames(path, CAMERA.resized(160, 100))


class Turned:
    """Stands in for OpenCV's capture of a phone's video, stored lying and shown upright."""

    def __init__(self, _: str) -> None:
        self.upright = True
        self.left = 3

    def isOpened(self) -> bool:  # noqa: N802
        return True

    def set(self, what: int, value: float) -> None:
        assert what == cv2.CAP_PROP_ORIENTATION_AUTO
        self.upright = bool(value)

    def get(self, what: int) -> float:
        return {cv2.CAP_PROP_FPS: 30.0, cv2.CAP_PROP_POS_MSEC: 0.0}.get(what, 3.0)

    def grab(self) -> bool:
        self.left -= 1
        return self.left >= 0

    def retrieve(self) -> tuple[bool, NDArray[np.uint8]]:
        lying = np.zeros((120, 160, 3), dtype=np.uint8)
        lying[:, :80, 0] = 200
        return True, np.rot90(lying) if self.upright else lying

    def release(self) -> None:
        return


def test_a_phones_video(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Upright, unless the camera is that of the stored picture; and where a file has no times, its
    rate says them."""
    monkeypatch.setattr("gscpe.sequences.video.cv2.VideoCapture", Turned)
    path = tmp_path / "phone.mov"
    path.write_bytes(b"video")
    upright = Camera.pinhole(120, 160, fx=150, fy=150, cx=60, cy=80)
    for camera in (upright, CAMERA):
        frames = list(open_frames(path, camera))
        assert {frame.image.shape[:2] for frame in frames if frame.image is not None} == {
            (camera.height, camera.width)
        }
        assert [frame.time for frame in frames] == pytest.approx([0, 1 / 30, 2 / 30], abs=1e-6)


def test_videos_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "clip.mp4"
    path.write_bytes(np.random.default_rng(0).bytes(5000))
    with pytest.raises(SequenceError, match=r"clip\.mp4 cannot be opened.*ffmpeg -i clip\.mp4"):
        open_frames(path, CAMERA)
    with pytest.raises(SequenceError, match=r"there is no video .*missing\.mp4"):
        OpenedVideo(tmp_path / "missing.mp4")
    with pytest.raises(SequenceError, match=r"there is no .*missing\.mp4; expected a video"):
        open_frames(tmp_path / "missing.mp4", CAMERA)
    path = write_video(tmp_path / "walk.mp4")
    with pytest.raises(CameraError, match=r"walk\.mp4 is not known.*--camera.*gscpe localize"):
        open_frames(path)


def test_a_video_that_is_cut_off(tmp_path: Path) -> None:
    path = write_video(tmp_path / "walk.avi", 100)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    frames = open_frames(path, CAMERA)
    count = len(list(frames))
    assert 20 < count < 60
    assert f"ends after {count} of 100 frames" in str(frames.trouble)


def test_a_frame_that_cannot_be_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Damaged(Turned):
        def retrieve(self) -> Any:
            return (False, None) if self.left == 1 else super().retrieve()

    monkeypatch.setattr("gscpe.sequences.video.cv2.VideoCapture", Damaged)
    (tmp_path / "phone.mov").write_bytes(b"video")
    frames = list(open_frames(tmp_path / "phone.mov", CAMERA))
    assert [frame.image is None for frame in frames] == [False, True, False]
    assert frames[1].trouble == "it cannot be decoded"
