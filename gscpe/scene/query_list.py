# SPDX-License-Identifier: Apache-2.0
"""Query photos: hloc's lists, ``name MODEL width height params...``, names alone, folders."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Sequence

from gscpe.errors import CameraError, QueryListError
from gscpe.geometry.camera import Camera
from gscpe.photos.photo_name import name_in_folder, split_quoted_name, with_slashes
from gscpe.photos.photo_size import SizeMisfit, fit_sizes, photo_size_or_none
from gscpe.photos.text_file import read_text_file
from gscpe.scene.colmap_files import MODELS

PHOTO_ENDINGS = {
    ".png",
    ".jpg",
    ".jpeg",
    ".jpe",
    ".jp2",
    ".bmp",
    ".tif",
    ".tiff",
    ".webp",
    ".ppm",
    ".pgm",
}
PHOTO_ENDINGS |= {".heic", ".heif"}  # taken for photos, whether they can be read here or not
# The last camera model in a line that has a number, or nothing, behind it: names have blanks.
_CAMERA = re.compile(
    rf"(.*\S)[\s,]+((?:{'|'.join(model for model, _ in MODELS)})"
    r"(?:[\s,]*|[\s,]+[-+]?\.?\d[^\s,]*(?:[\s,].*)?))",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Query:
    """A query photo: its name, relative to the image folder, and its camera."""

    name: str
    camera: Camera


def read_query_list(
    path: str | Path, camera: Camera | None = None, image_folder: str | Path | None = None
) -> tuple[Query, ...]:
    """The queries of a list, in its order.

    Names may have blanks, in double quotes or not; backslashes in them become ``/``. Commas
    between or after the words do not matter, nor does UTF-16 with a byte order mark.

    Args:
        path: of the list.
        camera: of the photos whose line is a name alone; None: each line has a camera.
        image_folder: a photo there that really has backslashes in its name keeps them.

    Raises:
        QueryListError: the file cannot be read, is empty, a line has another form, or a
            name comes twice.
    """
    path = Path(path)
    try:
        lines = read_text_file(path).split("\n")
    except OSError as error:
        raise QueryListError(f"query list {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise QueryListError(f"{path} is not a text file of queries") from error
    queries: dict[str, Query] = {}
    for number, line in enumerate((line.strip() for line in lines), start=1):
        if not line or line.startswith("#"):
            continue
        name, words = _parts(line)
        if not words and camera is None:
            raise QueryListError(
                f"{path}, line {number}: expected name MODEL width height params, got "
                f"{line[:60]!r}; names alone need one camera for all (--camera)"
            )
        try:
            own = Camera.parse(words) if words else camera
        except CameraError as error:
            raise QueryListError(f"{path}, line {number}: {error}") from None
        assert own is not None
        name = with_slashes(name) if image_folder is None else name_in_folder(image_folder, name)
        if name in queries:
            raise QueryListError(f"{path}, line {number}: {name} is already in the list")
        queries[name] = Query(name, own)
    if not queries:
        raise QueryListError(f"query list {path} is empty; expected name MODEL width height params")
    return tuple(queries.values())


def folder_queries(folder: str | Path, camera: Camera) -> tuple[Query, ...]:
    """All photos of a folder and the folders in it, by name, of one camera.

    Raises:
        QueryListError: there are none.
    """
    return tuple(Query(name, camera) for name in photo_names(folder))


def photo_names(folder: str | Path) -> list[str]:
    """Of all photos of a folder and the folders in it, sorted.

    Raises:
        QueryListError: there are none.
    """
    folder = Path(folder)
    paths = (path for path in folder.rglob("*") if path.suffix.lower() in PHOTO_ENDINGS)
    names = sorted(path.relative_to(folder).as_posix() for path in paths if path.is_file())
    if not names:
        raise QueryListError(f"{folder} holds no photos (.jpg, .png, ...)")
    return names


def fit_queries(queries: Sequence[Query], image_folder: str | Path) -> tuple[Query, ...]:
    """The queries with their cameras scaled, where all photos are larger or smaller than these
    by one factor; see :func:`gscpe.photos.photo_size.fit_sizes`.

    Otherwise as they were: a photo of another size is an error of its own.
    """
    sizes = []
    for query in queries:
        size = photo_size_or_none(Path(image_folder) / query.name)
        if size == (query.camera.width, query.camera.height):
            return tuple(queries)  # so there is no such factor, and no need to open all photos
        sizes.append(size)
    names, cameras = [query.name for query in queries], [query.camera for query in queries]
    fitted = fit_sizes(names, cameras, sizes)
    if isinstance(fitted, SizeMisfit):
        return tuple(queries)
    return tuple(replace(q, camera=camera) for q, camera in zip(queries, fitted, strict=True))


def _parts(line: str) -> tuple[str, str]:
    """A line's name, and the words of its camera, or none."""
    quoted = split_quoted_name(line)
    if quoted is not None:
        return quoted[0], quoted[1].strip(", \t")
    found = _CAMERA.fullmatch(line)
    if found is None:
        return line.rstrip(", \t"), ""
    return found[1].rstrip(", \t"), found[2].strip(", \t")
