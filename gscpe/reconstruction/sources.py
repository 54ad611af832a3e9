# SPDX-License-Identifier: Apache-2.0
"""What is to be put together: folders of photos, and videos."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Sequence

from gscpe.errors import ReconstructionError
from gscpe.given import real_path
from gscpe.scene.query_list import PHOTO_ENDINGS
from gscpe.sequences.video import VIDEO_ENDINGS


@dataclass(frozen=True)
class Source:
    """Files by the name that they shall have in the model.

    Attributes:
        photos: in the order of their names.
        videos: frames of a video are named ``name/000123.jpg``.
    """

    photos: dict[str, Path]
    videos: dict[str, Path]

    def stamp(self) -> list[list[str | int]]:
        """What tells whether these are the same files still."""
        return [
            [name, path.stat().st_size, path.stat().st_mtime_ns]
            for name, path in {**self.photos, **self.videos}.items()
        ]


def find_source(paths: Sequence[str | Path]) -> Source:
    """The photos and videos of folders (and the folders in them) and of single files.

    Raises:
        ReconstructionError: something is missing, or is neither photo nor video.
    """
    if isinstance(paths, str | Path):
        paths = [paths]
    photos: dict[str, Path] = {}
    videos: dict[str, Path] = {}
    for root in map(Path, paths):
        files = _files_of(root)
        within = root if root.is_dir() else root.parent
        for path in files:
            name = path.relative_to(within).as_posix()
            if len(paths) > 1 and within is root:
                name = f"{real_path(root).name}/{name}"
            if path.suffix.lower() in PHOTO_ENDINGS:
                photos[_free(name, photos)] = path
            elif path.suffix.lower() in VIDEO_ENDINGS:
                videos[_free(name.removesuffix(path.suffix), videos)] = path
    for name in list(videos):  # an iPhone's Live Photo is a photo with a clip of three seconds
        if any(path.with_suffix("") == videos[name].with_suffix("") for path in photos.values()):
            del videos[name]
    if not photos and not videos:
        raise ReconstructionError(
            f"{paths[0]} holds neither photos (.jpg, .png, .heic, ...) nor videos (.mp4, .mov, ...)"
        )
    return Source(dict(sorted(photos.items())), dict(sorted(videos.items())))


def _files_of(root: Path) -> list[Path]:
    if root.is_dir():
        return sorted(p for p in root.rglob("*") if p.is_file() and not _is_hidden(p, root))
    if not root.is_file():
        raise ReconstructionError(f"there is no folder of photos or video {root}")
    if root.suffix.lower() not in PHOTO_ENDINGS | VIDEO_ENDINGS:
        raise ReconstructionError(
            f"{root} is neither a photo nor a video, by its ending; give a folder of photos, or a "
            f"video ({', '.join(sorted(VIDEO_ENDINGS))})"
        )
    return [root]


def _is_hidden(path: Path, root: Path) -> bool:
    """Such as the ``._IMG_1.jpg`` that macOS leaves on other disks."""
    return any(part.startswith(".") for part in path.relative_to(root).parts)


def _free(name: str, taken: dict[str, Path]) -> str:
    number, free = 1, name
    while free in taken:
        number += 1
        stem, dot, ending = name.rpartition(".")
        free = f"{stem}-{number}.{ending}" if dot else f"{name}-{number}"
    return free
