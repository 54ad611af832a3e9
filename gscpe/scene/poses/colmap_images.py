"""COLMAP's images.txt: poses are world to camera, two lines a photo.

https://colmap.github.io/format.html#images-txt
"""

from __future__ import annotations

from typing import Mapping

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.geometry.camera import Camera
from gscpe.scene.poses.hloc import add_pose, format_pose, is_number, parse_pose


def parse_colmap_images(text: str, source: str) -> dict[str, Float64Array]:
    """``cam_from_world``, (4, 4), by photo; the lines of points are not kept.

    Raises:
        PoseError: a line has another form, or a name comes twice.
    """
    poses: dict[str, Float64Array] = {}
    points_are_next = False
    for number, line in enumerate(text.splitlines(), start=1):
        words, where = line.split(), f"{source}, line {number}"
        if points_are_next:
            if len(words) % 3 or not all(map(is_number, words)):
                raise PoseError(
                    f"{where}: expected the points of the photo before, 'X Y POINT3D_ID ...', or "
                    f"an empty line where it has none; got {line[:60]!r}"
                )
            points_are_next = False
            continue
        if not words or words[0].startswith("#"):
            continue
        if len(words) != 10 or not words[0].isdecimal() or not words[8].isdecimal():
            raise PoseError(
                f"{where}: expected 'IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME', "
                f"got {line[:60]!r}"
            )
        try:
            cam_from_world = parse_pose(" ".join(words[1:8]))
        except PoseError as error:
            raise PoseError(f"{where}: {error}") from None
        add_pose(poses, words[9], cam_from_world, where)
        points_are_next = True
    return poses


def format_colmap_images(
    poses: Mapping[str, Float64Array], cameras: Mapping[str, Camera] | None
) -> str:
    """The text of an images.txt without points.

    Equal cameras have the same id, from 1 in the order of their first photo; all photos
    have camera 1 where no cameras are given.

    Raises:
        PoseError: a photo has no camera.
    """
    ids: dict[Camera, int] = {}
    lines = [
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; world to camera\n",
        "# POINTS2D[] as (X, Y, POINT3D_ID): none\n",
    ]
    for number, (name, cam_from_world) in enumerate(poses.items(), start=1):
        camera_id = 1
        if cameras is not None:
            if name not in cameras:
                raise PoseError(f"{name} has a pose, but no camera; add it to the query list")
            camera_id = ids.setdefault(cameras[name], len(ids) + 1)
        lines.append(f"{number} {format_pose(cam_from_world)} {camera_id} {name}\n\n")
    return "".join(lines)
