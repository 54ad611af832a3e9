# SPDX-License-Identifier: Apache-2.0
"""Checks what callers give as an image, and says what to do with what is none."""

from __future__ import annotations

from pathlib import PurePath

import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.errors import PhotoError

_EXPECTED = "an image must be (height, width, 3) uint8 RGB"


def check_image(image: UInt8Array, transparent: bool = False) -> UInt8Array:
    """The image as (H, W, 3) uint8, or (H, W, 4) where it may be transparent; a grey one, (H, W)
    or (H, W, 1), gets three equal channels.

    What is BGR, as OpenCV reads it, cannot be told from RGB and is not noticed.

    Raises:
        PhotoError: it is a path, a list, of another shape or type, or empty.
    """
    if isinstance(image, str | bytes | PurePath):
        raise PhotoError(f"{_EXPECTED}, not a path: read {image!s} with gscpe.read_image first")
    if image is None or isinstance(image, list | tuple):
        raise PhotoError(
            f"{_EXPECTED}, not {_a(image)}: read it with gscpe.read_image, or make an array of it; "
            "give one image at a time"
        )
    image = np.asarray(image)
    if image.dtype != np.uint8:
        raise PhotoError(f"{_EXPECTED}, not {image.dtype}{_remedy_for(image.dtype)}")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim == 2:
        image = np.repeat(image[:, :, None], 3, axis=2)
    if image.ndim != 3 or image.shape[2] not in ((3, 4) if transparent else (3,)):
        raise PhotoError(f"{_EXPECTED}, not of shape {image.shape}{_reshaping(image.shape)}")
    if not image.size:
        raise PhotoError(f"{_EXPECTED}; this one has no pixels: its shape is {image.shape}")
    return image


def _a(thing: object) -> str:
    return "None" if thing is None else f"a {type(thing).__name__}"


def _remedy_for(dtype: np.dtype[np.generic]) -> str:
    if np.issubdtype(dtype, np.floating):
        return "; of floats in [0, 1], make bytes: np.rint(255 * image).astype(np.uint8)"
    if dtype == np.uint16:
        return "; of 16 bits, make bytes: (image >> 8).astype(np.uint8)"
    if np.issubdtype(dtype, np.integer):
        return "; of numbers from 0 to 255, make bytes: image.astype(np.uint8)"
    return ""


def _reshaping(shape: tuple[int, ...]) -> str:
    if len(shape) == 3 and shape[2] == 4:
        return "; leave out the fourth channel: image[:, :, :3]"
    if len(shape) == 3 and shape[0] in (1, 3):
        return "; put the channels last: image.transpose(1, 2, 0)"
    if len(shape) == 4:
        return "; give one image at a time"
    return ""
