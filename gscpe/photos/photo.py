# SPDX-License-Identifier: Apache-2.0
"""Photos: checking, masking, and removing lens distortion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Sequence, overload

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, UInt8Array, short_repr
from gscpe.errors import CameraError
from gscpe.geometry.camera import Camera
from gscpe.photos.image_array import check_image
from gscpe.photos.undistortion import Undistortion


@dataclass(frozen=True, eq=False)
class Photo:
    """A photo as a pinhole camera took it.

    Attributes:
        rgb: (H, W, 3) uint8.
        camera: pinhole camera of the same size.
        valid: (H, W) bool, false where the photo is transparent, or undistortion had nothing to
            show; None if all is valid.
    """

    rgb: UInt8Array
    camera: Camera
    valid: BoolArray | None = None

    def __repr__(self) -> str:
        return short_repr(self)


def luminance(rgb: UInt8Array | Float32Array) -> Float32Array:
    """Rec. 601 luminance of (H, W, 3), (H, W) float32; bytes become [0, 1]."""
    scale = np.float32(1.0 / 255.0 if rgb.dtype == np.uint8 else 1.0)
    grey = cv2.cvtColor(rgb.astype(np.float32, copy=False), cv2.COLOR_RGB2GRAY)
    return np.asarray(scale * grey, dtype=np.float32)


def brightest_channel(rgb: UInt8Array) -> UInt8Array:
    """Of each pixel of (..., 3), (...). (NumPy's max over a short axis takes six times as long.)"""
    red, green, blue = (rgb[..., channel] for channel in range(3))
    return np.asarray(np.maximum(np.maximum(red, green), blue), dtype=np.uint8)


def resized_photo(photo: Photo, scale: float) -> Photo:
    """The photo at about ``scale`` times its size, its camera scaled by what it really was."""
    height, width = photo.rgb.shape[:2]
    size = max(1, round(width * scale)), max(1, round(height * scale))
    rgb = resized_image(photo.rgb, *size)
    valid = None
    if photo.valid is not None:
        share = cv2.resize(photo.valid.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        valid = np.asarray(share > 0.99)
    return Photo(rgb, photo.camera.resized(*size), valid)


def resized_image(image: UInt8Array, width: int, height: int) -> UInt8Array:
    """An image, (H, W) or (H, W, C), at another size."""
    # Like the undistortion: OpenCV's cubic kernel moves edges by a fraction of a pixel.
    kernel = cv2.INTER_AREA if width < image.shape[1] else cv2.INTER_LANCZOS4
    return np.asarray(cv2.resize(image, (width, height), interpolation=kernel), dtype=np.uint8)


def shrink(image: Float32Array, width: int, height: int) -> Float32Array:
    """An image, (H, W) or (H, W, 3), at a smaller size; each pixel averages those it covers."""
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


def to_photo(image: UInt8Array, camera: Camera) -> Photo:
    """Checks an image against its camera and removes lens distortion, once.

    The undistorted photo keeps the size, the focal lengths and the principal point; of a fisheye,
    what :meth:`gscpe.Camera.without_distortion` says.

    Args:
        image: (H, W, 3) uint8 RGB, or (H, W) uint8 grey, or (H, W, 4) with an opacity: pixels that
            are more than half transparent are ignored. OpenCV reads BGR: convert it,
            ``image[:, :, ::-1]``.
        camera: the camera that took it.

    Raises:
        PhotoError: shape or dtype is wrong.
        CameraError: the camera is of another image size, or is no Camera.
    """
    image = check_image(image, transparent=True)
    if not isinstance(camera, Camera):
        raise CameraError(f"the photo's camera must be a gscpe.Camera, not {camera!r}")
    camera.check_fits(image.shape, "the photo")
    seen = image[:, :, 3] >= 128 if image.shape[2] == 4 else None
    rgb = np.ascontiguousarray(image[:, :, :3])
    if camera.is_pinhole:
        return Photo(rgb, camera, _unless_all(seen))
    undistortion = Undistortion.of(camera)
    valid = undistortion.valid(seen)
    return Photo(undistortion.image(rgb), undistortion.pinhole, _unless_all(valid))


def _unless_all(valid: BoolArray | None) -> BoolArray | None:
    return None if valid is None or bool(np.all(valid)) else np.asarray(valid)


class LazyPhotos(Sequence[Photo]):
    """Photos that are read when they are asked for, so that thousands need no memory.

    Args:
        count: how many there are.
        read: the photo of a number, from 0.
    """

    def __init__(self, count: int, read: Callable[[int], Photo]) -> None:
        self._count = count
        self._read = read

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> Photo: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Photo]: ...

    def __getitem__(self, index: int | slice) -> Photo | Sequence[Photo]:
        if isinstance(index, slice):
            return [self._read(i) for i in range(*index.indices(self._count))]
        return self._read(index)
