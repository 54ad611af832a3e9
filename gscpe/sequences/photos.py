# SPDX-License-Identifier: Apache-2.0
"""Frames that lie in files of their own: a folder, or a list."""

from __future__ import annotations

from pathlib import Path
from typing import Iterator, Sequence

from gscpe.errors import CameraError, PhotoError, QueryListError, SequenceError
from gscpe.geometry.camera import Camera
from gscpe.photos.image_file import read_image_of
from gscpe.poses import photo_numbers
from gscpe.scene.query_list import Query, fit_queries, folder_queries, read_query_list
from gscpe.sequences.frame import Frame, Frames
from gscpe.sequences.times import in_natural_order, read_times, times_of_names


class PhotoFrames(Frames):
    """Photos of a folder, in the order of their times, or of the numbers in their names.

    Args:
        queries: names and cameras.
        folder: that the names are relative to.
        times: seconds, one a photo; None: not known.
        description: see :class:`Frames`.

    Raises:
        SequenceError: none of the photos is there.
    """

    def __init__(
        self,
        queries: Sequence[Query],
        folder: str | Path,
        times: Sequence[float] | None,
        description: str,
    ) -> None:
        self._folder = Path(folder)
        if not any((self._folder / query.name).is_file() for query in queries):
            raise SequenceError(
                f"none of the {len(queries)} photos is in {self._folder}, the first is "
                f"{queries[0].name}; give the folder that the names are relative to (--images)"
            )
        self._queries = fit_queries(queries, folder)
        self._times = times
        self.description = description
        self.length = len(queries)

    def __iter__(self) -> Iterator[Frame]:
        times: Sequence[float | None] = self._times or [None] * len(self._queries)
        numbers = photo_numbers([query.name for query in self._queries])
        stamps = [""] * len(self._queries) if numbers is None else numbers
        for query, time, stamp in zip(self._queries, times, stamps, strict=True):
            image, trouble = None, None
            try:
                image = read_image_of(self._folder / query.name, query.camera)
            except (PhotoError, CameraError) as error:
                trouble = str(error)
            yield Frame(query.name, time, image, query.camera, trouble, stamp)


def folder_frames(
    folder: str | Path, camera: Camera, times: str | Path | None = None
) -> PhotoFrames:
    """All photos of a folder and the folders in it, of one camera.

    In the order of their times, where there is a file of these or all names are times; else by
    name, numbers in it as numbers.

    Raises:
        SequenceError: there are no photos, or the file of times is not one.
    """
    try:
        queries = folder_queries(folder, camera)
    except QueryListError as error:
        raise SequenceError(f"{error}, nor is it a ROS bag") from None
    names = in_natural_order([query.name for query in queries])
    seconds = times_of_names(names) if times is None else read_times(times, names)
    if seconds is not None:
        by_time = sorted(zip(seconds, names, strict=True))
        seconds, names = [time for time, _ in by_time], [name for _, name in by_time]
    return PhotoFrames(
        [Query(name, camera) for name in names], folder, seconds, f"photos of {folder}"
    )


def list_frames(
    path: str | Path,
    folder: str | Path | None = None,
    camera: Camera | None = None,
    times: str | Path | None = None,
) -> PhotoFrames:
    """The photos of a list, in its order.

    Args:
        path: hloc's list, ``name MODEL width height params...`` a line; or names alone.
        folder: of the photos; None: that of the list.
        camera: of the photos whose line is a name alone.
        times: file of times; None: those that the photos are named by, if they are.

    Raises:
        QueryListError: the list cannot be read; for example, it is empty.
        SequenceError: none of its photos is there, or the file of times is not one.
    """
    folder = Path(path).parent if folder is None else Path(folder)
    if not folder.is_dir():
        raise SequenceError(f"{folder} is not a folder of photos")
    queries = read_query_list(path, camera, folder)
    names = [query.name for query in queries]
    seconds = times_of_names(names) if times is None else read_times(times, names)
    return PhotoFrames(queries, folder, seconds, f"list {path}")
