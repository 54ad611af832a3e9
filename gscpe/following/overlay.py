# SPDX-License-Identifier: Apache-2.0
"""A video that shows how well the poses fit: photo, render and their difference, side by side.

It is made after the tracking, which needs the machine for itself: until then, only the poses are
kept, and the pictures of a live camera.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any, BinaryIO, Iterator

import cv2
import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.batch import keep_a_copy
from gscpe.closing import Closing
from gscpe.errors import OutputError
from gscpe.localization import Localizer
from gscpe.photos import to_photo, to_uint8
from gscpe.photos.image_array import check_image
from gscpe.photos.photo import resized_photo
from gscpe.render.pictures import UNSEEN, difference_picture, fit_light
from gscpe.sequences import Frame, Frames
from gscpe.tracking import TrackingResult

OVERLAY_ENDINGS = (".mp4", ".mkv", ".avi", ".mov")

_WIDEST = 640  # pixels, of each of the three pictures
_LINE = 24  # rows of the text above
_RATE = 30.0  # frames a second, of frames without times
_MOST, _LEAST = 120.0, 1.0
_JPEG_QUALITY = 92


class KeptFrames(Frames):
    """Live frames that are written to a file as they come, so that they can be had again.

    Args:
        frames: live; others can be read again, and are only passed on.
        path: of the file; it is deleted at the end.
    """

    def __init__(self, frames: Frames, path: Path) -> None:
        self._frames = frames
        self._path = path
        self.description, self.length, self.live = frames.description, frames.length, frames.live
        self._kept: list[Frame] | None = None

    def __iter__(self) -> Iterator[Frame]:
        if not self._frames.live:
            yield from self._frames
        elif self._kept is None:
            self._kept = []
            yield from self._first_time(self._kept)
        else:
            yield from self._again(self._kept)
        self.trouble = self._frames.trouble

    def _first_time(self, kept: list[Frame]) -> Iterator[Frame]:
        try:
            with self._path.open("wb") as file:
                for frame in self._frames:
                    if frame.image is not None:
                        _keep(file, frame.image)
                        kept.append(Frame(frame.name, frame.time, None, frame.camera))
                    yield frame
        except OSError as error:
            raise OutputError(f"{self._path} cannot be written: {error.strerror}") from error

    def _again(self, kept: list[Frame]) -> Iterator[Frame]:
        with self._path.open("rb") as file:
            for frame in kept:
                yield Frame(frame.name, frame.time, _kept(file), frame.camera)

    def delete(self) -> None:
        """Deletes the file."""
        self._path.unlink(missing_ok=True)


class Overlay(Closing):
    """Collects poses while frames are tracked, and writes the video after.

    Args:
        path: of the video, .mp4 for example.
        localizer: with the map that is tracked in; it is not closed.
        frames: that are tracked; give :attr:`frames` to the tracker in their place.

    Raises:
        OutputError: the ending is none of a video.
    """

    def __init__(self, path: str | Path, localizer: Localizer, frames: Frames) -> None:
        self._path = Path(path)
        if self._path.suffix.lower() not in OVERLAY_ENDINGS:
            raise OutputError(
                f"{path} does not end like a video: give {', '.join(OVERLAY_ENDINGS)}"
            )
        self._localizer = localizer
        kept = self._path.with_name(self._path.name + ".frames")
        self.frames = KeptFrames(frames, kept)
        self._results: dict[str, tuple[str, Float64Array | None]] = {}
        self._times: list[float] = []

    def add(self, frame: Frame, result: TrackingResult | None) -> None:
        """Keeps what the tracker said of a frame."""
        if result is None:
            return
        text = result.status if result.reason is None else f"{result.status}: {result.reason}"
        self._results[frame.name] = text, result.cam_from_world
        if frame.time is not None:
            self._times.append(frame.time)

    def write(self, progress: bool = False) -> None:
        """Writes the video: all frames that were tracked, at the rate at which they came.
        An earlier one is kept, with the ending ``.bak``.

        Raises:
            OutputError: it cannot be written.
            SequenceError: the frames cannot be read again.
            RenderError: rendering failed.
        """
        writer: Any = None
        bar = tqdm(
            desc=self._path.name,
            total=len(self._results),
            unit="frame",
            disable=not (progress and sys.stderr),
        )
        left = len(self._results)
        try:
            with bar:
                for frame in self.frames:
                    known = self._results.get(frame.name)
                    if known is None or frame.image is None:
                        continue
                    picture = self._picture(frame.image, frame, *known)
                    if writer is None:
                        writer = self._writer(picture)
                    writer.write(picture[:, :, ::-1].copy())
                    bar.update()
                    left -= 1
                    if left == 0:
                        break
        finally:
            if writer is not None:
                writer.release()

    def _picture(
        self,
        image: UInt8Array,
        frame: Frame,
        text: str,
        cam_from_world: Float64Array | None,
    ) -> UInt8Array:
        photo = to_photo(check_image(image, transparent=True), frame.camera)
        scale = min(1.0, _WIDEST / photo.camera.width)
        photo = photo if scale == 1.0 else resized_photo(photo, scale)
        if cam_from_world is None:
            render = np.full_like(photo.rgb, UNSEEN)
            difference = render
        else:
            view = self._localizer.render(photo.camera, cam_from_world)
            gain, bias = fit_light(photo.rgb, view)
            render = to_uint8(np.asarray(gain * view.rgb + bias, dtype=np.float32))
            difference = difference_picture(photo.rgb, view, gain, bias)
        picture = np.hstack([photo.rgb, render, difference])
        height, width = (2 * (side // 2) for side in picture.shape[:2])  # as codecs want it
        picture = np.ascontiguousarray(picture[:height, :width])
        picture[:_LINE] //= 3
        line, font = f"{frame.name}  {text}", cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, line, (8, 17), font, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
        return picture

    def _writer(self, picture: UInt8Array) -> Any:
        steps = np.diff(self._times)
        rate = 1.0 / float(np.median(steps)) if len(steps) else _RATE
        fourcc = cv2.VideoWriter.fourcc(*("MJPG" if self._path.suffix == ".avi" else "mp4v"))
        size = picture.shape[1], picture.shape[0]
        rate = min(max(rate, _LEAST), _MOST)
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            keep_a_copy(self._path)
        except OSError as error:
            raise OutputError(f"{self._path} cannot be written: {error.strerror}") from error
        writer = cv2.VideoWriter(str(self._path), fourcc, rate, size)
        if not writer.isOpened():
            raise OutputError(
                f"{self._path} cannot be written: this OpenCV has no encoder for "
                f"{self._path.suffix}; try .avi"
            )
        return writer

    def close(self) -> None:
        """Deletes the pictures that were kept meanwhile."""
        self.frames.delete()


def _keep(file: BinaryIO, image: UInt8Array) -> None:
    bgr = np.ascontiguousarray(image[:, :, 2::-1])
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    assert done
    file.write(struct.pack("<Q", len(data)))
    file.write(data.tobytes())
    file.flush()


def _kept(file: BinaryIO) -> UInt8Array:
    (size,) = struct.unpack("<Q", file.read(8))
    data = np.frombuffer(file.read(size), dtype=np.uint8)
    bgr = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert bgr is not None
    return np.ascontiguousarray(bgr[:, :, ::-1], dtype=np.uint8)
