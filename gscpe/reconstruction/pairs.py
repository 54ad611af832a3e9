# SPDX-License-Identifier: Apache-2.0
"""Which photos are worth matching with each other."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Callable, Sequence

import numpy as np

from gscpe.arrays import Float32Array
from gscpe.geometry.camera import Camera
from gscpe.photos import Photo, read_image
from gscpe.photos.photo import LazyPhotos
from gscpe.reconstruction.photos import PreparedPhoto
from gscpe.reconstruction.settings import ReconstructionSettings
from gscpe.reconstruction.work_folder import read_kept, write_kept
from gscpe.retrieval import describe_references


def choose_pairs(
    photos: Sequence[PreparedPhoto],
    image_folder: Path,
    settings: ReconstructionSettings,
    progress: bool = False,
) -> list[tuple[str, str]]:
    """Names of two photos each, those first that are most likely to show the same.

    Few photos are all paired. Of more, each is paired with those that look most like it (VLAD,
    gscpe.retrieval), and with those that come after it; in a video, also with one twice, four
    times, ... as far on, so that a pause does not cut it in two.
    """
    if len(photos) <= settings.all_pairs_up_to:
        chosen = list(combinations(range(len(photos)), 2))
    else:
        order = in_order(photos, settings.in_order)
        lazy = LazyPhotos(len(photos), lambda i: _plain_photo(image_folder / photos[i].name))
        described = describe_references(lazy, progress=progress)
        chosen = sorted({*order, *look_alike(described.descriptors, settings.most_similar)})
    return [(photos[a].name, photos[b].name) for a, b in chosen]


def chosen_once(path: Path, choose: Callable[[], list[tuple[str, str]]]) -> list[tuple[str, str]]:
    """What ``choose`` says; kept in a file, so that a run that goes on does not look at all photos
    again.

    Raises:
        OutputError: it cannot be written.
    """
    if path.exists():
        return [(a, b) for a, b in read_kept(path)]
    pairs = choose()
    write_kept(path, pairs)
    return pairs


def in_order(photos: Sequence[PreparedPhoto], count: int) -> list[tuple[int, int]]:
    """Each with the ``count`` that come after it, of the same video or none."""
    steps = [*range(1, count + 1), *(count * 2**power for power in range(1, 4))]
    return [
        (first, first + step)
        for first in range(len(photos))
        for step in steps
        if first + step < len(photos)
        and photos[first].video == photos[first + step].video
        and (step <= count or photos[first].video)
    ]


def look_alike(descriptors: Float32Array, count: int) -> list[tuple[int, int]]:
    """Each with the ``count`` whose descriptors, (N, D), are most similar; first below second."""
    similarity = descriptors @ descriptors.T
    np.fill_diagonal(similarity, -np.inf)
    pairs = set()
    for first, row in enumerate(similarity):
        for second in np.argsort(-row, kind="stable")[: min(count, len(row) - 1)]:
            pairs.add((min(first, int(second)), max(first, int(second))))
    return sorted(pairs)


def _plain_photo(path: Path) -> Photo:
    """How a photo is described does not depend on its camera."""
    image = read_image(path)[:, :, :3]
    height, width = image.shape[:2]
    focal = 1.2 * max(width, height)
    camera = Camera.pinhole(width, height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)
    return Photo(image, camera)
