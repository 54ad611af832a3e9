"""Intrinsics from what a camera wrote into its photo."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gscpe.errors import PhotoError
from gscpe.geometry.camera import Camera

_EXIF_BLOCK, _FOCAL_LENGTH_35MM = 0x8769, 0xA405
_DIAGONAL_35MM = float(np.hypot(36.0, 24.0))


def camera_from_exif(path: str | Path) -> Camera | None:
    """A guess of the camera of a photo, from the 35 mm equivalent of its focal length; None
    where the file does not say. The principal point is taken to be the middle.

    The equivalent is rounded to a millimetre, and holds for the diagonal (CIPA DCG-001); so it
    is a guess within some per cent, to be made exact by ``Localizer.estimate_camera``.

    Raises:
        PhotoError: the file is missing or is not an image.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            width, height = image.size
            equivalent = image.getexif().get_ifd(_EXIF_BLOCK).get(_FOCAL_LENGTH_35MM)
    except (
        *(OSError, UnidentifiedImageError, SyntaxError, ValueError),
        Image.DecompressionBombError,
    ) as error:
        raise PhotoError(f"{path} is not an image that can be decoded: {error}") from error
    try:
        millimetres = float(equivalent) if equivalent is not None else 0.0
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    if not 1.0 <= millimetres <= 2000.0:
        return None
    focal = millimetres * float(np.hypot(width, height)) / _DIAGONAL_35MM
    return Camera.pinhole(width, height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)
