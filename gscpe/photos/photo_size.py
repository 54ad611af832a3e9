# SPDX-License-Identifier: Apache-2.0
"""How large photos are, and cameras of photos that were made smaller since."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Sequence

from gscpe.errors import PhotoError
from gscpe.geometry.camera import Camera

_log = logging.getLogger(__name__)

Size = tuple[int, int]


def photo_size(path: str | Path) -> Size:
    """Width and height in pixels, as stored; only the header is read.

    Raises:
        PhotoError: the file is missing, or is not an image.
    """
    from PIL import Image

    try:
        with Image.open(path) as image:
            return image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise PhotoError(f"{path} is not an image that can be read: {error}") from error


def photo_size_or_none(path: str | Path) -> Size | None:
    """As :func:`photo_size`; None where it cannot be told, so that the reader may judge."""
    try:
        return photo_size(path)
    except PhotoError:
        return None


@dataclass(frozen=True)
class SizeMisfit:
    """A photo that no factor common to all makes fit; ``str`` of it says what is wrong."""

    name: str
    camera: Camera
    size: Size

    def __str__(self) -> str:
        (width, height), camera = self.size, self.camera
        if (height, width) == (camera.width, camera.height):
            return "it is turned by 90 degrees"
        if _factors(camera, self.size) is None:
            return "it is cropped, or from another camera"
        return (
            f"it is {width / camera.width:.4g} times as large, but others are not: photos may be "
            "larger or smaller than their cameras by one factor, the same for all"
        )


def fit_sizes(
    names: Sequence[str], cameras: Sequence[Camera], sizes: Sequence[Size | None]
) -> tuple[Camera, ...] | SizeMisfit:
    """The cameras of photos at the sizes that they have.

    Where all photos are larger or smaller than their cameras by one factor (folders such as
    images_2, images_4), up to a pixel of rounding, the cameras are scaled, which is exact
    (docs/conventions.md), and a warning is logged.

    Args:
        names: of the photos.
        cameras: of the photos as they were once.
        sizes: of the photos as they are; None where one is not known: it counts as fitting.

    Returns:
        The cameras, or the first photo that does not fit.
    """
    known = [
        (name, camera, size)
        for name, camera, size in zip(names, cameras, sizes, strict=True)
        if size is not None
    ]
    other = [row for row in known if row[2] != (row[1].width, row[1].height)]
    if not other:
        return tuple(cameras)
    if len(other) < len(known):
        return SizeMisfit(*other[0])
    least, greatest = 0.0, float("inf")
    for name, camera, size in known:
        low, high = _factors(camera, size) or (1.0, 0.0)
        least, greatest = max(least, low), min(greatest, high)
        if least > greatest:
            return SizeMisfit(name, camera, size)
    name, camera, size = known[0]
    _log.warning(
        "the photos are %.4g times as large as their cameras (the first, %s, is %dx%d, not %dx%d): "
        "the cameras are scaled",
        *(size[0] / camera.width, name, *size, camera.width, camera.height),
    )
    # Photos of an unknown size cannot be read: they fail later, one by one.
    return tuple(
        camera if size is None else camera.resized(*size)
        for camera, size in zip(cameras, sizes, strict=True)
    )


def _factors(camera: Camera, size: Size) -> tuple[float, float] | None:
    """The least and the greatest factor that make a camera of this size, each side within a
    pixel; None where no factor does, or where a pixel is all that differs."""
    low = max((length - 1) / whole for length, whole in _sides(camera, size))
    high = min((length + 1) / whole for length, whole in _sides(camera, size))
    if low > high or (low <= 1.0 <= high):
        return None
    return low, high


def _sides(camera: Camera, size: Size) -> tuple[tuple[int, int], tuple[int, int]]:
    return (size[0], camera.width), (size[1], camera.height)
