# SPDX-License-Identifier: Apache-2.0
"""Intrinsics from what a camera wrote into its photo."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from gscpe.errors import PhotoError
from gscpe.geometry.camera import Camera
from gscpe.photos.image_file import heic_photo, is_heic, photo_bytes
from gscpe.photos.orientation import exif_orientation, turned_camera

_EXIF_BLOCK, _FOCAL_LENGTH_35MM = 0x8769, 0xA405
_DIAGONAL_35MM = float(np.hypot(36.0, 24.0))


def camera_from_exif(path: str | Path, *, upright: bool = False) -> Camera | None:
    """A guess of the camera of a photo, from the 35 mm equivalent of its focal length; None
    where the file does not say. The principal point is taken to be the middle.

    The equivalent is rounded to a millimetre, and holds for the diagonal (CIPA DCG-001); so it
    is a guess within some per cent, to be made exact by ``Localizer.estimate_camera``.

    Args:
        path: of the photo.
        upright: of the photo turned as its EXIF orientation says, as :func:`gscpe.read_image`
            has it; else of the pixels as they are stored.

    Raises:
        PhotoError: the file is missing or is not an image.
    """
    return exif_camera(photo_bytes(path), path, upright)


def exif_camera(data: bytes, name: str | Path, upright: bool = False) -> Camera | None:
    """As :func:`camera_from_exif`, of the bytes of a file; ``name`` is what messages call it."""
    (width, height), exif = _size_and_exif(data, name)
    try:
        equivalent = exif.get_ifd(_EXIF_BLOCK).get(_FOCAL_LENGTH_35MM)
        millimetres = float(equivalent) if equivalent is not None else 0.0
    except (TypeError, ValueError, ZeroDivisionError, SyntaxError, KeyError):
        return None
    if not 1.0 <= millimetres <= 2000.0:
        return None
    focal = millimetres * float(np.hypot(width, height)) / _DIAGONAL_35MM
    camera = Camera.pinhole(width, height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)
    return turned_camera(camera, exif_orientation(data)) if upright else camera


def exif_of(path: Path) -> Any:
    """Pillow's EXIF tags of a photo; none where it has none.

    Raises:
        PhotoError: the file is missing or is not an image.
    """
    return _size_and_exif(photo_bytes(path), path)[1]


def _size_and_exif(data: bytes, name: str | Path) -> tuple[tuple[int, int], Any]:
    from PIL import Image, UnidentifiedImageError

    try:
        if is_heic(data):
            photo, exif = heic_photo(data, name), Image.Exif()
            exif.load(photo.info.get("exif") or b"")
            return photo.size, exif
        with Image.open(BytesIO(data)) as image:
            return image.size, image.getexif()
    except (
        *(OSError, UnidentifiedImageError, SyntaxError, ValueError),
        Image.DecompressionBombError,
    ) as error:
        raise PhotoError(f"{name} is not an image that can be decoded: {error}") from error
