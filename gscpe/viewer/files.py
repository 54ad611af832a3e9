# SPDX-License-Identifier: Apache-2.0
"""Reads what was found from the files that gscpe writes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Sequence

from gscpe.arrays import Float64Array
from gscpe.batch import read_details
from gscpe.errors import PoseError
from gscpe.given import parse_json
from gscpe.poses import poses_by_name, read_pose_file
from gscpe.viewer.contents import Findings


def read_findings(
    poses: str | Path | None = None,
    details: str | Path | None = None,
    truth: str | Path | None = None,
    trajectory: str | Path | None = None,
    map_name: str | None = None,
) -> Findings:
    """What the files hold; those that are None are left out.

    Args:
        poses, truth: of photos, in any form that :func:`gscpe.read_pose_file` reads.
        details: of ``gscpe localize``; None: those beside ``poses``, if they are there (beside
            ``poses.kitchen.txt`` of one of several maps, also ``poses.details.jsonl``).
        trajectory: in TUM's form.
        map_name: details of photos that were found in another one of several maps are left out,
            whose poses belong to another world.

    Raises:
        PoseError: a file cannot be read, or holds something else.
        OutputError: the details are no text.
    """
    if details is None and poses is not None:
        details = _details_beside(Path(poses), map_name)
    known = {}
    if details is not None:
        if not Path(details).is_file():
            why = "it is no file" if Path(details).exists() else "there is no such file"
            raise PoseError(f"details {details} cannot be read: {why}")
        known = read_details(details)
        if not known:
            raise PoseError(
                f"{details} holds no details as gscpe localize writes them (docs/formats.md)"
            )
        if map_name is not None:
            known = {
                name: detail
                for name, detail in known.items()
                if detail.get("map_name", map_name) == map_name
            }
    found = {} if poses is None else _named(poses, list(known))
    true = {} if truth is None else _named(truth, list(known or found))
    return Findings(found, known, true, {} if trajectory is None else read_trajectory(trajectory))


def read_trajectory(path: str | Path) -> dict[float, Float64Array]:
    """``cam_from_world``, (4, 4), by time in seconds, of a file in TUM's form.

    Raises:
        PoseError: it cannot be read, is in another form, or empty.
    """
    read = read_pose_file(path, "tum")
    if not read.poses:
        raise PoseError(f"trajectory {path} holds no poses")
    trajectory = {float(stamp): pose for stamp, pose in read.poses.items()}
    if not all(map(math.isfinite, trajectory)):
        raise PoseError(f"trajectory {path} has a time that is not finite")
    return trajectory


def _details_beside(poses: Path, map_name: str | None) -> Path | None:
    stems = [poses.stem]
    if map_name is not None and poses.stem.endswith(f".{map_name}"):
        stems.append(poses.stem.removesuffix(f".{map_name}"))
    for stem in stems:
        path = poses.parent / f"{stem}.details.jsonl"
        if path.is_file() and not _of_frames(path):
            return path
    return None


def _of_frames(path: Path) -> bool:
    """Whether these are the details of ``gscpe track``, which do not tell how a photo was found."""
    try:
        with path.open(encoding="utf-8") as file:
            first = parse_json(file.readline())
    except (OSError, ValueError):
        return False  # who reads it says so
    return isinstance(first, dict) and "anchor_age" in first


def _named(path: str | Path, names: Sequence[str]) -> dict[str, Float64Array]:
    """Poses by photo; those of a TUM file by the names that its timestamps stand for."""
    read = read_pose_file(path)
    if read.format == "tum" and names:
        return poses_by_name(read.poses, names)[0]
    return read.poses
