# SPDX-License-Identifier: Apache-2.0
"""Videos, through OpenCV: frames with their numbers and the times that the file has for them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Iterator

import cv2
import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.closing import Closing
from gscpe.errors import SequenceError
from gscpe.geometry.camera import Camera
from gscpe.sequences.camera import camera_of_size
from gscpe.sequences.frame import Frame, Frames

VIDEO_ENDINGS = {".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".3gp", ".mpg"}

_MOST_MISSING = 0.02
"""Share of the frames that a file announces which may be missing: its count may be a guess."""


class OpenedVideo(Closing):
    """A video; iterates over its frames, without decoding those that nobody asks for.

    Args:
        path: of the file.
        upright: turn the picture as the file says that it is shown; else as it is stored.

    Attributes:
        frames_a_second: as the file says; 30 where that cannot be.
        length: number of frames as the file says; None where it does not.

    Raises:
        SequenceError: it cannot be opened.
    """

    def __init__(self, path: Path, upright: bool = True) -> None:
        if not path.is_file():
            raise SequenceError(f"there is no video {path}")
        self._capture: Any = cv2.VideoCapture(str(path))
        if not self._capture.isOpened():
            raise SequenceError(
                f"{path} cannot be opened as a video; is it damaged? Convert it (ffmpeg -i "
                f"{path.name} -c:v libx264 out.mp4), or give a folder of photos"
            )
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, float(upright))
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.frames_a_second: float = rate if 1.0 <= rate <= 1000.0 else 30.0
        length = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.length = length if length > 0 else None

    def __iter__(self) -> Iterator[EncodedFrame]:
        number = 0
        while self._capture.grab():
            yield EncodedFrame(number, self._capture)
            number += 1

    def close(self) -> None:
        """Closes the file."""
        self._capture.release()


class EncodedFrame:
    """The frame at which a video is; it can be decoded until the next one is asked for.

    Attributes:
        number: from 0.
    """

    def __init__(self, number: int, capture: Any) -> None:
        self.number = number
        self._capture = capture

    def seconds(self) -> float:
        """Since the beginning, from the file, to a microsecond."""
        return round(float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0, 6)

    def decode_bgr(self) -> UInt8Array | None:
        """(H, W, 3), OpenCV's BGR; None where it cannot be decoded."""
        found, frame = self._capture.retrieve()
        return np.asarray(frame, dtype=np.uint8) if found and frame is not None else None


class VideoFrames(Frames):
    """The frames of a video file.

    The picture is upright, as it is shown, unless the camera has the size of the stored picture
    alone. Where the file has no times that increase, they come of its frame rate.

    Args:
        path: of the file.
        camera: that took it; at another size, it is scaled (up to a pixel of rounding).

    Raises:
        SequenceError: it cannot be opened or decoded.
        CameraError: the camera is of a picture of another shape.
    """

    def __init__(self, path: str | Path, camera: Camera) -> None:
        self._path = Path(path)
        self.description = f"video {self._path.name}"
        self._upright = True
        first = self._first(upright=True)
        if _is_turned(first, camera):
            stored = self._first(upright=False)
            if not _is_turned(stored, camera):
                first, self._upright = stored, False
        size = first.shape[1], first.shape[0]
        self._camera = camera_of_size(camera, size, self._path.name)

    def _first(self, upright: bool) -> UInt8Array:
        with OpenedVideo(self._path, upright) as video:
            self.length = video.length
            for frame in video:
                image = frame.decode_bgr()
                if image is not None:
                    return image
        raise SequenceError(
            f"{self._path} cannot be decoded; convert it (ffmpeg -i {self._path.name} -c:v libx264 "
            "out.mp4), or give a folder of photos"
        )

    def __iter__(self) -> Iterator[Frame]:
        self.trouble = None
        count, before, keeps_time = 0, -1.0, True
        with OpenedVideo(self._path, self._upright) as video:
            announced, rate = video.length, video.frames_a_second
            for encoded in video:
                count += 1
                seconds = encoded.seconds()
                if keeps_time and seconds <= before:
                    keeps_time = False
                if not keeps_time:
                    seconds = max(encoded.number / rate, before + 0.5 / rate)
                before = seconds
                image = encoded.decode_bgr()
                yield Frame(
                    f"{self._path.stem}/{encoded.number:06d}.jpg",
                    seconds,
                    None if image is None else np.ascontiguousarray(image[:, :, ::-1]),
                    self._camera,
                    "it cannot be decoded" if image is None else None,
                )
        if announced is not None and count < (1.0 - _MOST_MISSING) * announced - 1:
            self.trouble = (
                f"{self._path} ends after {count} of {announced} frames: it is cut off, or damaged"
            )


def _is_turned(image: UInt8Array, camera: Camera) -> bool:
    """Whether the picture would fit the camera if it were turned by a quarter."""
    wide, tall = image.shape[1] > image.shape[0], image.shape[1] < image.shape[0]
    return (wide and camera.width < camera.height) or (tall and camera.width > camera.height)
