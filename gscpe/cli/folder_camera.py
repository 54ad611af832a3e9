# SPDX-License-Identifier: Apache-2.0
"""One camera for a folder of photos, where none is given."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from itertools import islice
from pathlib import Path
from typing import Iterator, Sequence

from gscpe.arrays import UInt8Array
from gscpe.cli.common import localizer_settings
from gscpe.errors import PhotoError, QueryListError
from gscpe.geometry.camera import Camera
from gscpe.geometry.spread import evenly_spread
from gscpe.localization import Localizer
from gscpe.photos import read_image
from gscpe.photos.exif import camera_from_exif
from gscpe.photos.photo_size import photo_size_or_none
from gscpe.scene.query_list import photo_names

MOST_PHOTOS = 12
"""From which the camera is estimated."""


def estimated_camera(options: argparse.Namespace) -> Camera:
    """That of ``--images``, from some of the photos there, evenly spread over those of the most
    common size; the others are no photos of this camera.

    Raises:
        QueryListError: there are no photos.
        CameraError: the camera cannot be estimated.
        GscpeError: as of :class:`gscpe.Localizer`.
    """
    folder = Path(options.images)
    sizes = {name: photo_size_or_none(folder / name) for name in photo_names(folder)}
    common = Counter(size for size in sizes.values() if size is not None).most_common(1)
    if not common:
        raise QueryListError(f"{folder} holds no photo that can be read")
    alike = [name for name, size in sizes.items() if size == common[0][0]]
    few = evenly_spread(len(alike), MOST_PHOTOS)
    others = sorted(set(range(len(alike))) - set(few))
    paths = [folder / alike[index] for index in [*few, *others]]
    images = list(islice(_readable(paths), MOST_PHOTOS))
    if not images:
        raise QueryListError(f"{folder} holds no photo that can be read")
    settings = localizer_settings(options)
    with Localizer(options.map, settings, options.matcher, options.backend) as localizer:
        camera = localizer.estimate_camera([image for _, image in images], _guess(images))
    text = camera.colmap_text().replace(" ", ",")
    print(f"camera: {text} (estimated from up to {len(images)} photos)", file=sys.stderr)
    return camera


def _readable(paths: Sequence[Path]) -> Iterator[tuple[Path, UInt8Array]]:
    """Photos with their pixels, without those that are damaged behind their header."""
    for path in paths:
        try:
            yield path, read_image(path)
        except PhotoError:
            continue  # it fails alone, when it is to be localized


def _guess(images: Sequence[tuple[Path, UInt8Array]]) -> Camera | None:
    """That of the first photo whose EXIF says something."""
    cameras = (camera_from_exif(path) for path, _ in images)
    return next((camera for camera in cameras if camera is not None), None)
