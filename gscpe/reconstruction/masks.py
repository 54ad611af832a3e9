# SPDX-License-Identifier: Apache-2.0
"""What is to be left out of photos: people, cars, one's own shadow."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import cv2
import numpy as np

from gscpe.arrays import BoolArray, UInt8Array
from gscpe.errors import PhotoError
from gscpe.reconstruction.disk import when_full
from gscpe.reconstruction.photos import PreparedPhoto


def mask_path(folder: Path, name: str) -> Path | None:
    """The mask of a photo: ``NAME``, ``NAME.png`` or the name with ``.png`` for its ending."""
    candidates = [folder / name, folder / f"{name}.png", (folder / name).with_suffix(".png")]
    return next((path for path in candidates if path.is_file()), None)


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


def prepare_masks(photos: Sequence[PreparedPhoto], masks: Path, folder: Path) -> None:
    """Writes the masks as COLMAP wants them, ``NAME.png`` of the photo's size; white where there is
    none.

    Raises:
        PhotoError: there are no masks of these photos, or one cannot be used.
    """
    if not any(mask_path(masks, photo.name) for photo in photos):
        raise PhotoError(
            f"{masks} has no mask of these photos: masks are named like them, for example "
            f"{photos[0].name}.png, and black where the photo does not count"
        )
    for photo in photos:
        path = mask_path(masks, photo.name)
        mask: UInt8Array = np.full((photo.height, photo.width), 255, dtype=np.uint8)
        if path is not None:
            mask = read_mask(path, photo.width, photo.height).astype(np.uint8) * np.uint8(255)
        target = folder / f"{photo.name}.png"
        with when_full(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(cv2.imencode(".png", mask)[1].tobytes())
