# SPDX-License-Identifier: Apache-2.0
"""What can be known of a scale's source before structure from motion: whether it is of these
photos. A wrong name shall not cost an hour."""

from __future__ import annotations

from typing import Mapping, Sequence

from gscpe.errors import ReconstructionError
from gscpe.photos.photo_name import named_like
from gscpe.poses import read_pose_file
from gscpe.reconstruction.depth_scale import no_depth_images, read_depth
from gscpe.reconstruction.photos import PreparedPhoto
from gscpe.reconstruction.point_scale import check_pixel
from gscpe.reconstruction.scale import ScaleSource, check_gps, check_known_poses, name_in_model


def check_scale_source(
    source: ScaleSource, photos: Sequence[PreparedPhoto], unusable: Mapping[str, str]
) -> None:
    """Refuses what none of these photos could be scaled by, however they are placed.

    Args:
        source: of the unit.
        photos: that are to be put together.
        unusable: why others cannot be used, by name.

    Raises:
        ReconstructionError: too few of the photos that it names are among these, or have a GPS
            position; a pixel is outside of its photo; a depth image is something else.
        PoseError: a file of known poses cannot be read.
    """
    by_name = {photo.name: photo for photo in photos}
    if source.kind == "gps":
        check_gps(sum(photo.gps is not None for photo in photos), len(photos))
    elif source.kind == "poses":
        assert source.poses is not None
        known = read_pose_file(source.poses).poses
        check_known_poses(source.poses, [name for name in by_name if name in known], list(by_name))
    elif source.kind == "distance":
        for name in source.between:
            _named(name, by_name, unusable)
    elif source.kind == "points":
        assert source.lengths is not None
        measured = {name for pair in source.lengths.metres for name in pair}
        for point in sorted(measured):
            for name, pixel in source.lengths.seen[point].items():
                photo = _named(name, by_name, unusable)
                check_pixel(point, name, pixel, photo.full_size or (photo.width, photo.height))
    elif source.kind == "depth":
        assert source.depth is not None
        images = [(photo, named_like(source.depth, photo.name)) for photo in photos]
        found = [(photo, path) for photo, path in images if path is not None]
        if not found:
            raise no_depth_images(source.depth, photos[0].name)
        for photo, path in found[:1]:
            read_depth(path, photo.width, photo.height)


def _named(
    name: str, by_name: Mapping[str, PreparedPhoto], unusable: Mapping[str, str]
) -> PreparedPhoto:
    known = name_in_model(name, by_name)
    if known is not None:
        return by_name[known]
    why = unusable.get(name)
    if why is not None:
        raise ReconstructionError(
            f"{name}, which --scale-from names, cannot be used ({why}); take another photo"
        )
    raise ReconstructionError(
        f"{name}, which --scale-from names, is not among the photos; their names are like "
        f"{next(iter(by_name))}"
    )
