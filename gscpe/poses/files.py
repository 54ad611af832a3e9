# SPDX-License-Identifier: Apache-2.0
"""Reads and writes pose files of any of the forms."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Mapping

from gscpe.arrays import Float64Array, short_repr
from gscpe.errors import PoseError
from gscpe.geometry.camera import Camera
from gscpe.output_file import write_file
from gscpe.photos.photo_name import quoted_name
from gscpe.poses.colmap_images import format_colmap_images, parse_colmap_images
from gscpe.poses.detect import PoseFormat, detect_format
from gscpe.poses.hloc import format_pose, parse_poses, read_pose_text
from gscpe.poses.json_poses import format_json_poses, parse_json_poses
from gscpe.poses.tum import format_tum, parse_tum

_ENDINGS: dict[str, PoseFormat] = {".txt": "hloc", ".tum": "tum", ".json": "json"}


@dataclass(frozen=True, eq=False)
class PoseFile:
    """What a pose file holds.

    Attributes:
        format: that it was read as.
        poses: ``cam_from_world``, (4, 4) float64, by photo; by timestamp for ``tum``.
        cameras: by photo; only gscpe's details contain them, also for photos without a pose.
        not_finite: photos whose pose is NaN or infinite, with ``keep_not_finite``.
    """

    format: PoseFormat
    poses: dict[str, Float64Array]
    cameras: dict[str, Camera] = field(default_factory=dict)
    not_finite: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return short_repr(self)


def read_pose_file(
    path: str | Path, format: PoseFormat | None = None, *, keep_not_finite: bool = False
) -> PoseFile:
    """The poses of a file of any form.

    Args:
        path: of the file.
        format: its form; None: detected from its first line.
        keep_not_finite: NaN and infinite poses of ``hloc`` and ``pgt`` files are named in the
            result, as photos without a pose, instead of being an error.

    Raises:
        PoseError: the file cannot be read, its form is not known or not the one given, or
            a name comes twice; the message names the line.
    """
    text, source = read_pose_text(path), str(path)
    format = detect_format(text, source) if format is None else format
    if format == "json":
        return PoseFile(format, *parse_json_poses(text, source))
    if format == "tum":
        return PoseFile(format, parse_tum(text, source))
    if format == "colmap":
        return PoseFile(format, parse_colmap_images(text, source))
    lost: list[str] | None = [] if keep_not_finite else None
    poses = parse_poses(text, source, lost)
    return PoseFile(format, poses, not_finite=tuple(lost or ()))


def write_pose_file(
    path: str | Path,
    poses: Mapping[str, Float64Array],
    format: PoseFormat,
    cameras: Mapping[str, Camera] | None = None,
) -> None:
    """Writes poses; folders are made as needed.

    Args:
        path: of the file.
        poses: ``cam_from_world``, (4, 4), by photo.
        format: of the file.
        cameras: of all photos, those without a pose too. ``pgt`` takes the focal length from
            here, ``colmap`` the camera ids, and ``tum``, where photos are not named by
            numbers, their positions, which are counted in ``poses`` if this is None.

    Raises:
        PoseError: the form cannot hold what is given: for ``colmap`` a name with blanks, a
            photo without a camera or, for ``pgt``, with two focal lengths.
        OutputError: the file cannot be written.
    """
    if format == "json":
        text = format_json_poses(poses, cameras)
    elif format == "tum":
        text = format_tum(poses, list(poses if cameras is None else cameras))
    elif format == "colmap":
        text = format_colmap_images(poses, cameras)
    elif format == "pgt":
        text = "".join(
            f"{quoted_name(name)} {format_pose(pose)} {_focal_length(name, cameras or {}):.12g}\n"
            for name, pose in poses.items()
        )
    else:
        text = "".join(f"{quoted_name(name)} {format_pose(pose)}\n" for name, pose in poses.items())
    write_file(path, text.encode())


def format_of_path(path: str | Path) -> PoseFormat:
    """The form that a file's name stands for: ``images.txt`` is COLMAP's, other ``.txt`` are
    hloc's, ``.tum``, ``.json``.

    Raises:
        PoseError: it has another ending.
    """
    path = Path(path)
    if path.name == "images.txt":
        return "colmap"
    try:
        return _ENDINGS[path.suffix.lower()]
    except KeyError:
        raise PoseError(
            f"the file ending of {path} does not say which form of pose file it is (images.txt, "
            f"{', '.join(_ENDINGS)} do); say which (--to)"
        ) from None


def is_colmap_folder(path: str | Path, format: PoseFormat | None) -> bool:
    """Whether a whole COLMAP model is to be written: to a folder that there is, or to a name
    without ending (``sparse/0``, or any with ``--to colmap``)."""
    path = Path(path)
    if format not in (None, "colmap"):
        return False
    return path.is_dir() or not path.suffix


def _focal_length(name: str, cameras: Mapping[str, Camera]) -> float:
    if name not in cameras:
        raise PoseError(f"pgt needs the focal length of {name}; give a query list that has it")
    camera = cameras[name]
    if not math.isclose(camera.fx, camera.fy, rel_tol=1e-6):
        raise PoseError(
            f"pgt holds one focal length, but {name} has {camera.fx:g} and {camera.fy:g}"
        )
    return camera.fx
