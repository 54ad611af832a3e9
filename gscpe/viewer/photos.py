# SPDX-License-Identifier: Apache-2.0
"""The photos behind the cameras: found in folders, without lens distortion, small."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import cv2
import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.errors import InputError
from gscpe.photos import read_image_of, to_photo
from gscpe.viewer.cameras import ShownCamera


class Photos:
    """Photos by name, from the first folder that has them.

    Args:
        folders: that names are relative to; may be none.

    Raises:
        InputError: a folder is not there.
    """

    def __init__(self, folders: Sequence[str | Path]) -> None:
        self._folders = [Path(folder) for folder in folders]
        for folder in self._folders:
            if not folder.is_dir():
                raise InputError(f"--images {folder} is not a folder")

    def path(self, name: str) -> Path | None:
        """Of the photo; None where no folder has it."""
        for folder in self._folders:
            if (folder / name).is_file():
                return folder / name
        return None

    def picture(self, shown: ShownCamera, width: int) -> UInt8Array | None:
        """The photo without lens distortion, (H, W, 3) uint8, at most so wide; None where it is
        not there, cannot be read, or is not of the camera's size."""
        path = self.path(shown.name)
        if path is None:
            return None
        try:
            rgb = to_photo(read_image_of(path, shown.camera), shown.camera).rgb
        except InputError:
            return None
        height = max(1, round(rgb.shape[0] * width / rgb.shape[1]))
        if rgb.shape[1] > width:
            rgb = np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA))
        return np.asarray(rgb, dtype=np.uint8)
