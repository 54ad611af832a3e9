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


def prepare_masks(
    photos: Sequence[PreparedPhoto], masks: str | Path | None, folder: Path
) -> Path | None:
    """Writes the masks as COLMAP wants them, ``NAME.png`` of the photo's size; white where there is
    none.

    Args:
        photos: whose masks they are.
        masks: folder of pictures named like the photos; None: all of the photos counts.
        folder: to write to, ``masks`` in it.

    Returns:
        The folder with the masks; None where there are to be none.

    Raises:
        PhotoError: there are no masks of these photos, or one cannot be used.
    """
    if masks is None:
        return None
    check_masks(Path(masks), [photo.name for photo in photos])
    folder = folder / "masks"
    for photo in photos:
        path = named_like(Path(masks), photo.name)
        mask: UInt8Array = np.full((photo.height, photo.width), 255, dtype=np.uint8)
        if path is not None:
            mask = read_mask(path, photo.width, photo.height).astype(np.uint8) * np.uint8(255)
        target = folder / f"{photo.name}.png"
        with when_full(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(cv2.imencode(".png", mask)[1].tobytes())
    return folder
