# SPDX-License-Identifier: Apache-2.0
"""A frame as it is aligned: an undistorted grey pyramid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable

import cv2
import numpy as np

from gscpe.arrays import BoolArray, UInt8Array
from gscpe.errors import CameraError, PhotoError
from gscpe.geometry.camera import Camera
from gscpe.photos.image_array import check_image
from gscpe.photos.photo import resized_image
from gscpe.photos.undistortion import Undistortion
from gscpe.refinement.pyramid import ImageLevel, photo_pyramid
from gscpe.tracking.motion import Motion

_SMALLEST_SIDE = 16
"""An image is not halved below this."""

_DARK, _BRIGHT = 40, 250


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame.

    Attributes:
        index: its number.
        time: in seconds, or its number where no times are given.
        motion: since the frame before, where that was measured.
        levels: of its pyramid, full size first.
        darkest, brightest: luminance that a thousandth of the pixels are beyond.
    """

    index: int
    time: float
    motion: Motion | None
    levels: tuple[ImageLevel, ...]
    darkest: int
    brightest: int

    @property
    def camera(self) -> Camera:
        """The pinhole camera of the full size."""
        return self.levels[0].camera

    def trouble(self) -> str | None:
        """Says that it is almost black or almost white; None where it is neither."""
        if self.brightest <= _DARK:
            return f"the frame is almost black (brightest value {self.brightest} of 255)"
        if self.darkest >= _BRIGHT:
            return f"the frame is almost white (darkest value {self.darkest} of 255)"
        return None


class FrameMaker:
    """Makes frames; what a camera's distortion needs is made once.

    Args:
        scale_of: times by which a photo of a pinhole camera is resized.
        levels: times it is halved.
    """

    def __init__(self, scale_of: Callable[[Camera], float], levels: int) -> None:
        self._scale_of = scale_of
        self._levels = levels
        self._camera: Camera | None = None
        self._undistortion: Undistortion | None = None
        self._pinhole: Camera | None = None
        self._all: BoolArray | None = None

    def frame(
        self, image: UInt8Array, camera: Camera, index: int, time: float, motion: Motion | None
    ) -> Frame:
        """Checks an image against its camera, as :func:`gscpe.to_photo`.

        Raises:
            PhotoError, CameraError: as :func:`gscpe.to_photo`.
        """
        if not isinstance(camera, Camera):
            raise CameraError(f"a frame's camera must be a gscpe.Camera, not {camera!r}")
        grey, seen = _grey(image)
        camera.check_fits(grey.shape, "the frame")
        if camera != self._camera:
            self._use(camera)
        assert self._pinhole is not None and self._all is not None
        valid: BoolArray | None = seen
        if self._undistortion is not None:
            grey = self._undistortion.image(grey)
            valid = self._undistortion.valid(seen) if seen is not None else None
        size = self._pinhole.width, self._pinhole.height
        if grey.shape != (size[1], size[0]):
            grey = resized_image(grey, *size)
        if valid is None:
            valid = self._all
        elif valid.shape != grey.shape:
            share = cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
            valid = np.asarray(share > 0.99)
        luminance = np.multiply(grey, np.float32(1.0 / 255.0), dtype=np.float32)
        pinhole = self._pinhole
        levels = photo_pyramid(
            *(luminance, valid, pinhole),
            most_levels(pinhole, self._levels),
        )
        # Every fourth pixel of every fourth row: enough to tell black from white.
        beyond = np.cumsum(np.bincount(grey[::4, ::4].ravel(), minlength=256))
        few = max(1, beyond[-1] // 1000)
        darkest, brightest = np.searchsorted(beyond, [few, beyond[-1] - few + 1])
        return Frame(index, time, motion, levels, int(darkest), int(brightest))

    def _use(self, camera: Camera) -> None:
        self._undistortion = None if camera.is_pinhole else Undistortion.of(camera)
        pinhole = camera.without_distortion()
        scale = self._scale_of(pinhole)
        if scale != 1.0:
            size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
            pinhole = pinhole.resized(*size)
        self._pinhole = pinhole
        size = pinhole.width, pinhole.height
        if self._undistortion is None:
            self._all = np.ones((size[1], size[0]), dtype=bool)
        else:
            inside = self._undistortion.inside.astype(np.float32)
            share = cv2.resize(inside, size, interpolation=cv2.INTER_LINEAR)
            self._all = np.asarray(share > 0.99)
        self._camera = camera


def most_levels(camera: Camera, levels: int) -> int:
    """Times an image may be halved."""
    return max(
        0, min(levels, (min(camera.width, camera.height) // _SMALLEST_SIDE).bit_length() - 1)
    )


def _grey(image: UInt8Array) -> tuple[UInt8Array, BoolArray | None]:
    """Rec. 601 luminance, (H, W) uint8, and where the image is not transparent, if it may be."""
    if isinstance(image, np.ndarray) and image.ndim == 2 and image.dtype == np.uint8 and image.size:
        return image, None
    image = check_image(image, transparent=True)
    seen = image[:, :, 3] >= 128 if image.shape[2] == 4 else None
    try:
        code = cv2.COLOR_RGB2GRAY if seen is None else cv2.COLOR_RGBA2GRAY
        grey = cv2.cvtColor(image, code)
    except cv2.error as error:
        raise PhotoError(f"the frame cannot be made grey: {error}") from error
    return np.asarray(grey, dtype=np.uint8), seen
