# SPDX-License-Identifier: Apache-2.0
"""How much a request may ask for, and what a photo's header says before anything is decoded."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

from gscpe.errors import CameraError, PhotoError
from gscpe.geometry.camera import Camera
from gscpe.photos.image_file import heic_photo, is_heic
from gscpe.ranges import check_numbers, check_whole
from gscpe.service.problem import ProblemError, too_large

FORMATS = ("JPEG", "PNG", "WEBP")
"""Of Pillow; HEIC is read as well."""


@dataclass(frozen=True)
class Limits:
    """Of a service.

    Attributes:
        body_bytes: of a request, and of a frame.
        pixels: of a photo, and of a camera: a small file may hold a picture that fills the memory.
        idle_seconds: that a connection may take to send the head of a request, or to take an
            answer.
        upload_seconds: that the body may take to arrive, or the next frame of a camera.
        decode_seconds: that a worker may take to decode a photo.
        seconds: for which a worker may give no sign of life after that; it gives one at each step.
        queue: requests at a time that are uploaded, wait or are worked on; more are turned away.
        trackers: cameras that are followed at a time, a process each.
    """

    body_bytes: int = 32_000_000
    pixels: int = 60_000_000
    idle_seconds: float = 20.0
    upload_seconds: float = 60.0
    decode_seconds: float = 20.0
    seconds: float = 120.0
    queue: int = 64
    trackers: int = 2

    def __post_init__(self) -> None:
        check_whole(self, "body_bytes", "pixels", "queue", least=1)
        check_numbers(self, "idle_seconds", "upload_seconds", "decode_seconds", "seconds", above=0)
        check_whole(self, "trackers", least=0)


def check_photo(data: bytes, name: str, limits: Limits) -> tuple[int, int]:
    """Width and height of a photo, from its header; nothing is decoded.

    Raises:
        PhotoError: it is no JPEG, PNG, WebP or HEIC.
        ProblemError: it has too many pixels.
    """
    width, height = _size(data, name)
    if width * height > limits.pixels:
        raise ProblemError(
            too_large(f"{name} has {width}x{height} pixels, more than {limits.pixels}; shrink it")
        )
    return width, height


def check_camera(camera: Camera, limits: Limits) -> None:
    """Of a view that is asked for, or of frames that are to come.

    Raises:
        CameraError: it has too many pixels.
    """
    if camera.width * camera.height > limits.pixels:
        raise CameraError(
            f"a camera may have {limits.pixels} pixels here, not {camera.width}x{camera.height}"
        )


def _size(data: bytes, name: str) -> tuple[int, int]:
    from PIL import Image

    if is_heic(data):
        width, height = heic_photo(data, name).size
        return int(width), int(height)
    try:
        with Image.open(BytesIO(data), formats=FORMATS) as image:
            return image.size
    except Image.DecompressionBombError:
        raise ProblemError(too_large(f"{name} has far too many pixels; shrink it")) from None
    except Exception:  # parsers of damaged headers raise anything
        raise PhotoError(
            f"{name} is not an image that can be decoded; expected JPEG, PNG, WebP or HEIC"
        ) from None
