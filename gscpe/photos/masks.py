# SPDX-License-Identifier: Apache-2.0
"""What is to be left out of photos: people, cars, one's own shadow."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from gscpe.arrays import BoolArray, UInt8Array
from gscpe.errors import PhotoError
from gscpe.photos.photo_name import named_like


def read_mask(path: Path, width: int, height: int) -> BoolArray:
    """Where a photo counts, (H, W): where its mask is not black. It is resized to the photo.

    Raises:
        PhotoError: it is no image, or of another shape than the photo.
    """
    data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    mask = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    if mask is None:
        raise PhotoError(f"mask {path} is not an image that can be decoded")
    if abs(mask.shape[1] * height - mask.shape[0] * width) > 2 * max(mask.shape[1], mask.shape[0]):
        raise PhotoError(
            f"mask {path} is {mask.shape[1]}x{mask.shape[0]}, but its photo, upright, is "
            f"{width}x{height}: the shapes differ"
        )
    small = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(small > 0)


def masked_image(image: UInt8Array, path: Path) -> UInt8Array:
    """An image, (H, W, 3) or with opacity (H, W, 4), as (H, W, 4) that is transparent where its
    mask is black.

    Raises:
        PhotoError: as :func:`read_mask`; or it is black everywhere.
    """
    height, width = image.shape[:2]
    counts = read_mask(path, width, height)
    if not np.any(counts):
        raise PhotoError(f"mask {path} is black everywhere; leave its photo out instead")
    opacity = image[:, :, 3] if image.shape[2] == 4 else np.full(counts.shape, 255, dtype=np.uint8)
    return np.dstack([image[:, :, :3], np.where(counts, opacity, 0).astype(np.uint8)])


def check_masks(masks: Path, names: list[str]) -> None:
    """Raises PhotoError where a folder has no mask of these photos."""
    if not any(named_like(masks, name) for name in names):
        raise PhotoError(
            f"{masks} has no mask of these photos: masks are named like them, for example "
            f"{names[0]}.png, and black where the photo does not count"
        )
