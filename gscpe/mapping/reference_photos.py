# SPDX-License-Identifier: Apache-2.0
"""The photos of the references, read when they are needed."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.geometry.camera import Camera
from gscpe.photos import Photo, read_image_of, to_photo
from gscpe.scene import References


def reference_image(references: References, index: int, image_folder: str | Path) -> UInt8Array:
    """The photo of a reference as its camera took it, (H, W, 3).

    Raises:
        PhotoError: it cannot be read.
        CameraError: it is of another size than its camera.
    """
    return read_image_of(Path(image_folder) / references.names[index], references.cameras[index])


def reference_photo(references: References, index: int, image_folder: str | Path) -> Photo:
    """The same without distortion."""
    image = reference_image(references, index, image_folder)
    return to_photo(image, references.cameras[index])


def at_most(image: UInt8Array, camera: Camera, longest_side: int) -> tuple[UInt8Array, Camera]:
    """A photo, (H, W, 3), and its camera, distorted or not, made no larger than so many pixels."""
    scale = longest_side / max(camera.width, camera.height)
    if scale >= 1.0:
        return image, camera
    size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return small, camera.resized(*size)
