# SPDX-License-Identifier: Apache-2.0
"""Photos of data sets on disk: which there are, what they are called, how large they are."""

from __future__ import annotations

import logging
import os
from pathlib import Path, PurePosixPath
from typing import Iterable, Mapping

from gscpe.errors import DatasetError, PhotoError
from gscpe.geometry.camera import Camera
from gscpe.photos.photo_size import photo_size

_ENDINGS = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")
_logger = logging.getLogger(__name__)


def without_ending(name: str) -> str:
    """``seq1/frame00001`` of ``seq1/frame00001.png``; other dots stay."""
    head, ending = os.path.splitext(name)
    return head if ending in _ENDINGS else name


def photo_on_disk(folder: Path, name: str) -> str | None:
    """The name of a listed photo in ``folder``: as listed, or with another ending, or None."""
    names = (name, *(without_ending(name) + ending for ending in _ENDINGS))
    return next((n for n in names if os.path.isfile(folder / n)), None)


def photos_on_disk(folder: Path, names: Iterable[str], source: str) -> dict[str, str]:
    """Listed name -> name in ``folder``; photos that are not there are left out, with a warning.

    Raises:
        DatasetError: none of them is there; the message names the first.
    """
    listed = list(names)
    on_disk = {name: photo_on_disk(folder, name) for name in listed}
    found = {name: there for name, there in on_disk.items() if there is not None}
    lost = [name for name in listed if name not in found]
    if lost and not found:
        raise DatasetError(
            f"{folder / lost[0]} is missing, and so are all {len(lost)} photos of the list; "
            f"they come from {source}"
        )
    if lost:
        _logger.warning(
            "%d of %d photos are not in %s and are left out; the first is %s",
            *(len(lost), len(listed), folder, lost[0]),
        )
    return found


def list_photos(folder: Path, pattern: str = "*") -> list[str]:
    """Sorted names of the photos right in a folder, one of each if there are several endings."""
    paths = [path for path in folder.glob(pattern) if path.suffix in _ENDINGS and path.is_file()]
    paths.sort(key=lambda path: (path.stem, _ENDINGS.index(path.suffix)))
    first = {path.stem: path.name for path in reversed(paths)}
    return sorted(first.values())


def image_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels, as stored; only the header is read.

    Raises:
        DatasetError: the file is missing or not an image.
    """
    try:
        return photo_size(path)
    except PhotoError as error:
        raise DatasetError(str(error)) from error


def image_sizes(folder: Path, names: Iterable[str]) -> dict[str, tuple[int, int]]:
    """Width and height of each photo, from one photo of each folder (a sequence is one camera).

    Raises:
        DatasetError: one of these is not an image.
    """
    size_of: dict[str, tuple[int, int]] = {}
    sizes = {}
    for name in names:
        parent = str(PurePosixPath(name).parent)
        if parent not in size_of:
            size_of[parent] = image_size(folder / name)
        sizes[name] = size_of[parent]
    return sizes


def check_sizes(folder: Path, cameras: Mapping[str, Camera]) -> None:
    """Compares one photo of each folder and camera size with its camera.

    Raises:
        DatasetError: a photo has another size than its camera, or is not an image.
    """
    seen = set()
    for name, camera in cameras.items():
        key = (PurePosixPath(name).parent, camera.width, camera.height)
        if key in seen:
            continue
        seen.add(key)
        width, height = image_size(folder / name)
        if (width, height) != key[1:]:
            raise DatasetError(
                f"{folder / name} is {width}x{height}, but its camera is "
                f"{camera.width}x{camera.height}; give the photos that the cameras belong to"
            )


def common_parent(*folders: Path) -> Path:
    """The folder that holds all these, or is one of them; links are not followed.

    Raises:
        DatasetError: there is none (two drives).
    """
    try:
        return Path(os.path.commonpath([os.path.abspath(folder) for folder in folders]))
    except ValueError as error:
        raise DatasetError(f"photos have no folder in common: {error}") from error


def relative_name(folder: Path, path: Path) -> str:
    """The name of a photo relative to a folder above it, with ``/`` on every system."""
    return Path(os.path.relpath(os.path.abspath(path), os.path.abspath(folder))).as_posix()
