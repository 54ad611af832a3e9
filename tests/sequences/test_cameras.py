# SPDX-License-Identifier: Apache-2.0
"""Cameras from files, and camera devices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gscpe.errors import CameraError, SequenceError
from gscpe.geometry import Camera
from gscpe.sequences import open_frames, read_camera

TEXT = "PINHOLE,64,48,50,51,32,24"
CAMERA = Camera.parse(TEXT)

ROS = """image_width: 64
image_height: 48
camera_name: left
camera_matrix: {rows: 3, cols: 3, data: [50, 0, 31.5, 0, 51, 23.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0.2, 0.3, 0.4, 0.5]}
"""
VIKIT = """cam_model: Pinhole
cam_width: 64
cam_height: 48
scale: 0.5
cam_fx: 50
cam_fy: 51
cam_cx: 31.5
cam_cy: 23.5
cam_d0: 0.1
"""


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("camera.txt", TEXT.replace(",", " ") + "\n", TEXT),
        ("cameras.txt", "# Camera list\n1 PINHOLE 64 48 50 51 32 24\n", TEXT),
        ("left.yaml", ROS, "FULL_OPENCV 64 48 50 51 32 24 0.1 0.2 0.3 0.4 0.5 0 0 0"),
        ("camera_pinhole.yaml", VIKIT, "OPENCV 64 48 50 51 32 24 0.1 0 0 0"),
    ],
)
def test_camera_files(name: str, text: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    assert read_camera(str(tmp_path / name)) == Camera.parse(expected)
    assert read_camera(expected) == Camera.parse(expected)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("cameras.txt", "1 PINHOLE 64 48 50 51 32 24\n2 PINHOLE 64 48 50 51 32 24\n", "2 cameras"),
        ("camera.txt", "PINHOLE 64\n", "camera.txt: camera 'PINHOLE 64' is not of the form"),
        ("a.yaml", "image_width: 3\ncamera_matrix: 4\n", "expected image_width, image_height"),
        ("b.yaml", "cam_fx: many\n", "cam_width is missing"),
    ],
)
def test_camera_files_that_are_none(name: str, text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(CameraError, match=words):
        read_camera(str(tmp_path / name))
    with pytest.raises(CameraError, match="is not of the form"):
        read_camera(str(tmp_path / "missing.yaml"))


class Webcam:
    """Stands in for OpenCV's capture of a camera at the machine: five frames, and it is
    unplugged."""

    opened: str | int | None = None
    sizes: tuple[tuple[int, float], ...] = ()
    frames = 5

    def __init__(self, device: str | int) -> None:
        Webcam.opened = device
        Webcam.sizes = ()
        self.number = 0

    def isOpened(self) -> bool:  # noqa: N802
        return Webcam.opened != 9

    def set(self, what: int, value: float) -> None:
        Webcam.sizes += ((what, value),)

    def read(self) -> tuple[bool, NDArray[np.uint8] | None]:
        if self.number == self.frames:
            return False, None
        self.number += 1
        image = np.zeros((48, 64, 3), np.uint8)
        image[:, :, 0] = 10 * self.number
        return True, image

    def release(self) -> None:
        return


def test_a_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gscpe.sequences.device.cv2.VideoCapture", Webcam)
    frames = open_frames("device:0", CAMERA.resized(128, 96))
    assert (Webcam.opened, [value for _, value in Webcam.sizes]) == (0, [128, 96])
    assert frames.live
    read = list(frames)
    assert len(read) == 4  # the first one told the size
    times = [frame.time or 0.0 for frame in read]
    assert times == sorted(times) and times[0] > 1.7e9
    assert {frame.camera for frame in read} == {CAMERA}
    assert [int(f.image[0, 0, 2]) for f in read if f.image is not None] == [20, 30, 40, 50]
    assert "delivers no frames any more" in str(frames.trouble)
    list(open_frames("device:/dev/video7", CAMERA))
    assert Webcam.opened == "/dev/video7"


def test_devices_that_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gscpe.sequences.device.cv2.VideoCapture", Webcam)
    with pytest.raises(SequenceError, match="device 9 cannot be opened: is it plugged in"):
        open_frames("device:9", CAMERA)
    monkeypatch.setattr(Webcam, "frames", 0)
    with pytest.raises(SequenceError, match="delivers no frames"):
        open_frames("device:0", CAMERA)
