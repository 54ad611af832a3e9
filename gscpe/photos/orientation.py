# SPDX-License-Identifier: Apache-2.0
"""Photos that are stored turned: what EXIF says, and turning pixels, cameras and poses alike.

An orientation is EXIF's number, 1 to 8: how the stored pixels must be turned to be seen upright
(EXIF 2.32, tag 0x0112). The four rotations are in QUARTER_TURNS; the others are mirrored too.
"""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.geometry.camera import Camera

QUARTER_TURNS = (1, 6, 3, 8)
"""Orientations that turn the stored photo clockwise by 0, 90, 180 and 270 degrees."""

_ORIENTATION = 0x0112
_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Of directions in the image, clockwise."""
_MIRRORED = {2: 0, 4: 2, 5: 3, 7: 1}
"""Orientations that mirror left and right first, and the quarter turns after that."""


def exif_orientation(photo: str | Path | bytes) -> int:
    """What EXIF says of a photo (a path, or the bytes of a file), 1 to 8; 1, upright, where it
    does not say or cannot be read.

    HEIC photos are read as they are to be shown (:func:`gscpe.read_image`): always 1.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(BytesIO(photo) if isinstance(photo, bytes) else photo) as image:
            value = image.getexif().get(_ORIENTATION, 1)
    except (
        *(OSError, UnidentifiedImageError, SyntaxError, ValueError, TypeError, KeyError),
        Image.DecompressionBombError,
    ):
        return 1
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


def inverse_orientation(orientation: int) -> int:
    """What turns an upright photo back."""
    return {6: 8, 8: 6}.get(orientation, orientation)


def turned_image(image: UInt8Array, orientation: int) -> UInt8Array:
    """An image, (H, W) or (H, W, C), turned upright."""
    mirrored, quarters = _parts(orientation)
    if mirrored:
        image = image[:, ::-1]
    return np.ascontiguousarray(np.rot90(image, -quarters))


def turned_camera(camera: Camera, orientation: int) -> Camera:
    """The camera of the photo that :func:`turned_image` returns; exact, distortion included."""
    mirrored, quarters = _parts(orientation)
    if mirrored:
        camera = replace(
            camera,
            cx=camera.width - camera.cx,
            distortion=_distortion_turned(camera, np.diag([-1.0, 1.0])),
        )
    numbers = numbers_turned(orientation)
    for _ in range(quarters):
        # Clockwise: right becomes down, down becomes left.
        camera = replace(
            camera,
            width=camera.height,
            height=camera.width,
            fx=camera.fy,
            fy=camera.fx,
            cx=camera.height - camera.cy,
            cy=camera.cx,
            distortion=_distortion_turned(camera, _QUARTER),
        )
    return camera.with_covariance(numbers @ camera.covariance_matrix() @ numbers.T)


def numbers_turned(orientation: int) -> Float64Array:
    """(5, 5), from the five numbers of a small change of the camera that stored the photo (see
    ``Camera.covariance``) to those of the turned photo's."""
    mirrored, quarters = _parts(orientation)
    turned = np.linalg.matrix_power(_QUARTER, quarters) @ np.diag([-1.0 if mirrored else 1.0, 1.0])
    numbers = np.eye(5)
    numbers[1, 1] = -1.0 if quarters % 2 else 1.0  # fx and fy change places
    numbers[2:4, 2:4] = turned
    return numbers


def turned_from_cam(orientation: int) -> Float64Array:
    """The (4, 4) rotation about the viewing axis from the frame of the camera that stored the
    photo to that of the turned photo: ``turned_from_cam @ cam_from_world`` is its pose.

    ValueError for orientations that mirror: no rotation does.
    """
    mirrored, quarters = _parts(orientation)
    if mirrored:
        raise ValueError(f"orientation {orientation} mirrors the photo")
    rotation = np.eye(4)
    rotation[:2, :2] = np.linalg.matrix_power(_QUARTER, quarters)
    return rotation


def swaps_sides(orientation: int) -> bool:
    """Whether width and height change places."""
    return _parts(orientation)[1] % 2 == 1


def _parts(orientation: int) -> tuple[bool, int]:
    """Whether it mirrors left and right first, and the quarter turns clockwise after that."""
    if orientation in _MIRRORED:
        return True, _MIRRORED[orientation]
    return False, QUARTER_TURNS.index(orientation)


def _distortion_turned(camera: Camera, turn: Float64Array) -> tuple[float, ...]:
    """Tangential distortion is a vector in the image, (p2, p1), and so is a fisheye's prism."""
    if not camera.distortion:
        return ()
    k1, k2, p1, p2, k3, k4, *last = camera.distortion
    p2, p1 = (float(x) for x in turn @ (p2, p1))
    if camera.fisheye:
        last = [float(x) for x in turn @ last]
    return (k1, k2, p1, p2, k3, k4, *last)
