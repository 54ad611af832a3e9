# SPDX-License-Identifier: Apache-2.0
"""Trajectories in TUM's form: ``timestamp tx ty tz qx qy qz qw``, camera to world.

https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats
"""

from __future__ import annotations

import math
import re
from typing import Mapping, Sequence

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.geometry import se3
from gscpe.photos.photo_name import is_number
from gscpe.poses.hloc import add_pose, pose_lines

_NUMBER = re.compile(r"\d+(\.\d+)?")


def parse_tum(text: str, source: str) -> dict[str, Float64Array]:
    """``cam_from_world``, (4, 4), by timestamp (as it is written in the file).

    Raises:
        PoseError: a line has another form, or a timestamp comes twice.
    """
    poses: dict[str, Float64Array] = {}
    for number, line in pose_lines(text):
        where = f"{source}, line {number}"
        words = line.split()
        if len(words) != 8 or not all(map(is_number, words)) or not math.isfinite(float(words[0])):
            raise PoseError(
                f"{where}: expected 'timestamp tx ty tz qx qy qz qw', got {line[:60]!r}"
            )
        tx, ty, tz, qx, qy, qz, qw = map(float, words[1:])
        try:
            world_from_cam = se3.from_quaternion_translation([qw, qx, qy, qz], [tx, ty, tz])
        except PoseError as error:
            raise PoseError(f"{where}: {error}") from None
        add_pose(poses, words[0], se3.inverse(world_from_cam), where)
    return poses


def format_tum(poses: Mapping[str, Float64Array], names: Sequence[str]) -> str:
    """The lines of a file, in the order of time.

    Args:
        poses: ``cam_from_world``, (4, 4), by photo.
        names: of all photos, those without a pose too: what positions are counted in.

    Raises:
        PoseError: a pose is of a photo that is not in ``names``.
    """
    stamps = dict(zip(names, timestamps(names), strict=True))
    missing = [name for name in poses if name not in stamps]
    if missing:
        raise PoseError(f"{missing[0]} has a pose, but is not in the list of photos")
    lines = []
    for name in sorted(poses, key=lambda name: float(stamps[name])):
        lines.append(tum_line(stamps[name], poses[name]))
    return "".join(lines)


def tum_line(stamp: str, cam_from_world: Float64Array) -> str:
    """A line of a file: time, and camera to world."""
    (qw, qx, qy, qz), t = se3.to_quaternion_translation(se3.inverse(cam_from_world))
    numbers = " ".join(f"{number:.12g}" for number in (*t, qx, qy, qz, qw))
    return f"{stamp} {numbers}\n"


def timestamps(names: Sequence[str]) -> list[str]:
    """The numbers that photos are named by, if all are and no two by the same; else their
    positions in the list, from 0."""
    numbers = photo_numbers(names)
    return [str(position) for position in range(len(names))] if numbers is None else numbers


def photo_numbers(names: Sequence[str]) -> list[str] | None:
    """``1311868164.363181`` of ``rgb/1311868164.363181.png``, for each name.

    None unless all names are numbers (folders and ending ignored), and all different.
    """
    stems = []
    for name in names:
        stem = name.replace("\\", "/").rsplit("/", 1)[-1]
        head, _, ending = stem.rpartition(".")
        stems.append(head if head and not ending.isdecimal() else stem)
    if not all(_NUMBER.fullmatch(stem) for stem in stems):
        return None
    return stems if len(set(map(float, stems))) == len(stems) else None
