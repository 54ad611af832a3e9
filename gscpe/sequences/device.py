# SPDX-License-Identifier: Apache-2.0
"""A camera at this machine, through OpenCV."""

from __future__ import annotations

import time
from typing import Any, Iterator

import cv2
import numpy as np

from gscpe.errors import SequenceError
from gscpe.geometry.camera import Camera
from gscpe.sequences.camera import camera_of_size
from gscpe.sequences.frame import Frame, Frames, stamp_text

_MOST_FAILURES = 30
"""Frames in a row that a camera may fail to deliver, as some do while they start."""


class DeviceFrames(Frames):
    """Frames of a camera device, until it is unplugged or the caller stops. Live.

    The device is asked for pictures of the camera's size; where it has another, the camera is
    scaled. A frame's time is when it arrived, in seconds since 1970.

    Args:
        device: number (``0``) or path (``/dev/video0``) of the device.
        camera: its intrinsics.

    Raises:
        SequenceError: the device cannot be opened or delivers nothing.
        CameraError: its pictures have another shape than the camera.
    """

    live = True

    def __init__(self, device: str, camera: Camera) -> None:
        self.description = f"camera device {device}"
        self._capture: Any = cv2.VideoCapture(int(device) if device.isdecimal() else device)
        if not self._capture.isOpened():
            raise SequenceError(
                f"camera device {device} cannot be opened: is it plugged in (ls /dev/video*), are "
                "you allowed to use it (group video), and does no other program use it?"
            )
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, camera.width)
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, camera.height)
        first = self._read()
        if first is None:
            self._capture.release()
            raise SequenceError(f"camera device {device} is open, but delivers no frames")
        self._camera = camera_of_size(camera, first.shape[1::-1], self.description)

    def _read(self) -> Any:
        for _ in range(_MOST_FAILURES):
            found, image = self._capture.read()
            if found and image is not None:
                return image
        return None

    def __iter__(self) -> Iterator[Frame]:
        self.trouble = None
        # The clock of the day may be set back meanwhile; this one runs forward.
        offset = time.time() - time.monotonic()
        try:
            while (image := self._read()) is not None:
                now = offset + time.monotonic()
                rgb = np.ascontiguousarray(image[:, :, ::-1])
                yield Frame(stamp_text(now), now, rgb, self._camera)
            self.trouble = f"{self.description} delivers no frames any more"
        finally:
            self._capture.release()
