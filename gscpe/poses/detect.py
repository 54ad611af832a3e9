# SPDX-License-Identifier: Apache-2.0
"""The forms of pose files, and which of them a text has."""

from __future__ import annotations

from typing import Literal, Sequence, get_args

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.photos.photo_name import is_number
from gscpe.poses.hloc import pose_lines, split_pose_line

PoseFormat = Literal["hloc", "pgt", "colmap", "tum", "json"]
"""``hloc``: name, quaternion, translation; ``pgt``: the same with a focal length, 7-Scenes'
pseudo ground truth; ``colmap``: images.txt; ``tum``: a trajectory; ``json``: ours."""

POSE_FORMATS: tuple[PoseFormat, ...] = get_args(PoseFormat)

_EXPECTED = (
    "'name qw qx qy qz tx ty tz' (hloc), the same and a focal length (pgt), "
    "'IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME' (colmap), "
    "'timestamp tx ty tz qx qy qz qw' (tum), or JSON"
)


def detect_format(text: str, source: str) -> PoseFormat:
    """The form of a file's text, by its first line; ``hloc`` where there is none.

    Eight numbers in a line may be TUM's or, where photos are named by numbers alone, hloc's:
    there, it is the one of which more lines have a quaternion of unit length.

    Raises:
        PoseError: no form fits, or two do.
    """
    if text.lstrip().startswith(("{", "[")):
        return "json"
    lines = list(pose_lines(text))
    if not lines:
        return "hloc"
    number, line = lines[0]
    fits = [kind for kind in POSE_FORMATS if _fits(kind, line)]
    if not fits:
        raise PoseError(f"{source}, line {number}: expected {_EXPECTED}; got {line[:60]!r}")
    if fits == ["hloc", "tum"]:
        rows = [line.split() for _, line in lines if _fits("tum", line)]
        numbers = np.array([[float(word) for word in row] for row in rows])
        hloc, tum = _of_unit_length(numbers[:, 1:5]), _of_unit_length(numbers[:, 4:])
        if hloc != tum:
            return "hloc" if hloc > tum else "tum"
    if len(fits) > 1:
        raise PoseError(
            f"{source}, line {number}: {line[:60]!r} may be of the form "
            f"{' or '.join(fits)}; say which (gscpe convert-poses --from {fits[0]})"
        )
    return fits[0]


def _fits(kind: PoseFormat, line: str) -> bool:
    if kind == "json":
        return False
    words = line.split()
    if kind == "colmap":
        whole = len(words) >= 10 and words[0].isdecimal() and words[8].isdecimal()
        return whole and _all_numbers(words[1:8])
    if kind == "tum":
        return len(words) == 8 and _all_numbers(words)
    parts = split_pose_line(line)
    return parts is not None and len(parts[1]) in ((8,) if kind == "pgt" else (7, 9))


def _all_numbers(words: Sequence[str]) -> bool:
    return all(is_number(word.rstrip(",")) for word in words)


def _of_unit_length(quaternions: Float64Array) -> int:
    return int(np.count_nonzero(np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) < 1e-3))
