# SPDX-License-Identifier: Apache-2.0
"""Masks as COLMAP wants them."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import cv2
import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.photos.masks import check_masks, read_mask
from gscpe.photos.photo_name import named_like
from gscpe.reconstruction.disk import when_full
from gscpe.reconstruction.photos import PreparedPhoto


def prepare_masks(photos: Sequence[PreparedPhoto], masks: Path, folder: Path) -> None:
    """Writes the masks as COLMAP wants them, ``NAME.png`` of the photo's size; white where there is
    none.

    Raises:
        PhotoError: there are no masks of these photos, or one cannot be used.
    """
    check_masks(masks, [photo.name for photo in photos])
    for photo in photos:
        path = named_like(masks, photo.name)
        mask: UInt8Array = np.full((photo.height, photo.width), 255, dtype=np.uint8)
        if path is not None:
            mask = read_mask(path, photo.width, photo.height).astype(np.uint8) * np.uint8(255)
        target = folder / f"{photo.name}.png"
        with when_full(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(cv2.imencode(".png", mask)[1].tobytes())
