# SPDX-License-Identifier: Apache-2.0
"""COLMAP's images.txt: poses are world to camera, two lines a photo.

https://colmap.github.io/format.html#images-txt
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterator, Mapping

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.geometry.camera import Camera
from gscpe.photos.photo_name import is_number
from gscpe.poses.colmap_folder import camera_ids
from gscpe.poses.hloc import add_pose, format_pose, parse_pose


@dataclass(frozen=True)
class ImageLine:
    """A photo's line: where it stands, for errors, and what it says."""

    where: str
    image_id: int
    pose: str
    camera_id: int
    name: str

    def cam_from_world(self) -> Float64Array:
        """(4, 4).

        Raises:
            PoseError: a number is not finite, or the quaternion is zero.
        """
        try:
            return parse_pose(self.pose)
        except PoseError as error:
            raise PoseError(f"{self.where}: {error}") from None


def image_lines(text: str, source: str) -> Iterator[ImageLine]:
    """The photos' lines; those of points are skipped. Names may have blanks: they come last.

    Raises:
        PoseError: a line has another form.
    """
    points_are_next = False
    for number, line in enumerate(text.split("\n"), start=1):
        where = f"{source}, line {number}"
        if points_are_next:
            words = line.split()
            if len(words) % 3 or not all(map(is_number, (*words[:3], *words[-1:]))):
                raise PoseError(
                    f"{where}: expected the points of the photo before, 'X Y POINT3D_ID ...', or "
                    f"an empty line where it has none; got {line[:60]!r}"
                )
            points_are_next = False
            continue
        words = line.strip().split(None, 9)
        if not words or words[0].startswith("#"):
            continue
        if len(words) != 10 or not words[0].isdecimal() or not words[8].isdecimal():
            raise PoseError(
                f"{where}: expected 'IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME', "
                f"got {line[:60]!r}"
            )
        yield ImageLine(where, int(words[0]), " ".join(words[1:8]), int(words[8]), words[9])
        points_are_next = True


def parse_colmap_images(text: str, source: str) -> dict[str, Float64Array]:
    """``cam_from_world``, (4, 4), by photo; the lines of points are not kept.

    Raises:
        PoseError: a line has another form, or a name comes twice.
    """
    poses: dict[str, Float64Array] = {}
    for line in image_lines(text, source):
        add_pose(poses, line.name, line.cam_from_world(), line.where)
    return poses


def format_colmap_images(
    poses: Mapping[str, Float64Array], cameras: Mapping[str, Camera] | None
) -> str:
    """The text of an images.txt without points.

    Equal cameras have the same id, from 1 in the order of their first photo; all photos
    have camera 1 where no cameras are given.

    Raises:
        PoseError: a photo has no camera, or has blanks in its name.
    """
    cut = [name for name in poses if name.split() != [name]]
    if cut:
        raise PoseError(
            f"photo {cut[0]!r} has blanks in its name, where COLMAP cuts names in text files; "
            "give a folder in place of images.txt, for binary files"
        )
    ids = {} if cameras is None else camera_ids(poses, cameras)
    lines = [
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; world to camera\n",
        "# POINTS2D[] as (X, Y, POINT3D_ID): none\n",
    ]
    for number, (name, cam_from_world) in enumerate(poses.items(), start=1):
        camera_id = 1 if cameras is None else ids[cameras[name]]
        lines.append(f"{number} {format_pose(cam_from_world)} {camera_id} {name}\n\n")
    return "".join(lines)
