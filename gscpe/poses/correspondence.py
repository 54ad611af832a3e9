# SPDX-License-Identifier: Apache-2.0
"""Whose poses those of a TUM file are: it has timestamps, where other files have names."""

from __future__ import annotations

from typing import Literal, Mapping, Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.poses.tum import photo_numbers

MatchedBy = Literal["number", "position"]

_TOLERANCE = 1e-6  # seconds; float64 resolves 2.4e-7 s of a time since 1970


def poses_by_name(
    poses: Mapping[str, Float64Array], names: Sequence[str], by_position: bool = True
) -> tuple[dict[str, Float64Array], MatchedBy]:
    """The poses of a TUM file under the names of a list of photos, and how they were matched.

    By number, where all names are numbers and some timestamp is one of them (within 1e-6);
    else by position, where all timestamps are positions in the list, from 0. Timestamps that
    are of no photo of the list stay as they are.

    Args:
        poses: by timestamp.
        names: of the photos, in the order that positions are counted in.
        by_position: whether matching by position may be tried.

    Raises:
        PoseError: neither is the case, or two timestamps are of one photo.
    """
    numbers = photo_numbers(names)
    stamps = np.array([float(stamp) for stamp in poses])
    if not poses or not names:
        return dict(poses), "number"
    if numbers is not None:
        known = np.array([float(number) for number in numbers])
        order = np.argsort(known)
        ranks = np.searchsorted(known[order], stamps - _TOLERANCE)
        nearest = order[np.minimum(ranks, len(known) - 1)]
        same = np.abs(known[nearest] - stamps) <= _TOLERANCE
        if np.any(same):
            found = [names[i] if hit else None for i, hit in zip(nearest, same, strict=True)]
            return _renamed(poses, found), "number"
    if by_position and np.all((stamps == np.floor(stamps)) & (stamps >= 0) & (stamps < len(names))):
        return _renamed(poses, [names[int(stamp)] for stamp in stamps]), "position"
    how = f", nor are all positions in that list (0 to {len(names) - 1})" if by_position else ""
    raise PoseError(
        f"the timestamps of the TUM file are not the photos' numbers{how}; for example "
        f"{next(iter(poses))!r} against {names[0]!r}. Give both files with the same names"
    )


def _renamed(
    poses: Mapping[str, Float64Array], names: Sequence[str | None]
) -> dict[str, Float64Array]:
    renamed: dict[str, Float64Array] = {}
    for (stamp, pose), name in zip(poses.items(), names, strict=True):
        key = stamp if name is None else name
        if key in renamed:
            raise PoseError(f"two timestamps of the TUM file are of {key}, one is {stamp}")
        renamed[key] = pose
    return renamed
