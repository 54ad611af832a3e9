# SPDX-License-Identifier: Apache-2.0
"""Pose files in hloc's form: ``name qw qx qy qz tx ty tz``, world to camera."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Iterator, Sequence

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.geometry import se3
from gscpe.photos.photo_name import is_number, split_quoted_name
from gscpe.photos.text_file import read_text_file


def parse_pose(text: str) -> Float64Array:
    """``cam_from_world``, (4, 4), of the text ``qw qx qy qz tx ty tz`` (blanks or commas).

    Raises:
        PoseError: the text has another form.
    """
    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 7:
        raise PoseError(f"pose {text!r} is not of the form qw qx qy qz tx ty tz (world to camera)")
    return se3.from_quaternion_translation(numbers[:4], numbers[4:])


def format_pose(cam_from_world: Float64Array) -> str:
    """``qw qx qy qz tx ty tz``; :func:`parse_pose` reads it back, right to 1e-9 up to 1000
    units from the origin."""
    quaternion, translation = se3.to_quaternion_translation(cam_from_world)
    return " ".join(f"{number:.12g}" for number in (*quaternion, *translation))


def read_poses(path: str | Path) -> dict[str, Float64Array]:
    """Names and ``cam_from_world``, (4, 4), of a pose file.

    Up to two more numbers are ignored (the focal length of the 7-Scenes pseudo ground truth,
    the two errors in DSAC*'s estimates), and so are empty lines and lines that begin with
    ``#``. Names may have blanks, in double quotes or not; see :func:`split_pose_line`.

    Raises:
        PoseError: the file cannot be read, a line has another form, or a name comes twice.
    """
    return parse_poses(read_pose_text(path), str(path))


def parse_poses(
    text: str, source: str, not_finite: list[str] | None = None
) -> dict[str, Float64Array]:
    """As :func:`read_poses`, of the text of a file; ``source`` names it in errors.

    Where a list is given for them, photos whose pose is NaN or infinite, as some programs write
    it when they have none, go there instead of being an error.
    """
    poses: dict[str, Float64Array] = {}
    for number, line in pose_lines(text):
        parts = split_pose_line(line)
        if parts is None:
            raise PoseError(
                f"{source}, line {number}: expected 'name qw qx qy qz tx ty tz', got {line[:60]!r}"
            )
        name, words = parts
        if not_finite is not None and _are_numbers_but_not_finite(words[:7]):
            not_finite.append(name)
            continue
        try:
            cam_from_world = parse_pose(" ".join(words[:7]))
        except PoseError as error:
            raise PoseError(f"{source}, line {number}: {error}") from None
        add_pose(poses, name, cam_from_world, f"{source}, line {number}")
    return poses


def split_pose_line(line: str) -> tuple[str, list[str]] | None:
    """The name that a line begins with, which may have blanks, and the 7 to 9 numbers after it;
    None where there are others.

    The numbers are found from the end. A name without quotes may end in a number; then its pose
    is told from a line with more than 7 numbers by the quaternion, which is of unit length.
    """
    quoted = split_quoted_name(line)
    if quoted is not None:
        words = quoted[1].split()
        return (quoted[0], words) if _are_numbers(words) and 7 <= len(words) <= 9 else None
    words = line.split()
    count = 0
    while count < len(words) - 1 and _are_numbers(words[-1 - count :][:1]):
        count += 1
    if count < 7:
        return None
    if count > 7 and _is_unit(words[-7:-3]) and not (count <= 9 and _is_unit(words[-count:][:4])):
        count = 7
    return (line.rsplit(None, count)[0], words[-count:]) if count <= 9 else None


def add_pose(
    poses: dict[str, Float64Array], name: str, cam_from_world: Float64Array, where: str
) -> None:
    """Raises PoseError when the name has a pose already."""
    if name in poses:
        raise PoseError(f"{where}: {name} already has a pose")
    poses[name] = cam_from_world


def read_pose_text(path: str | Path) -> str:
    """The text of a pose file.

    Raises:
        PoseError: the file cannot be read, or is no text.
    """
    path = Path(path)
    try:
        return read_text_file(path)
    except OSError as error:
        raise PoseError(f"pose file {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise PoseError(f"{path} is not a text file of poses") from error


def pose_lines(text: str) -> Iterator[tuple[int, str]]:
    """Number, from 1, and text of the lines that are neither empty nor begin with ``#``."""
    for number, line in enumerate(text.splitlines(), start=1):
        stripped = line.strip()
        if stripped and not stripped.startswith("#"):
            yield number, stripped


def _are_numbers_but_not_finite(words: Sequence[str]) -> bool:
    return all(map(is_number, words)) and not all(math.isfinite(float(word)) for word in words)


def _are_numbers(words: Sequence[str]) -> bool:
    return all(is_number(word.rstrip(",")) for word in words)


def _is_unit(words: Sequence[str]) -> bool:
    return abs(math.hypot(*(float(word.rstrip(",")) for word in words)) - 1.0) < 1e-3
