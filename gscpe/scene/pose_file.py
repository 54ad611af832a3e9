"""Pose files in hloc's form: ``name qw qx qy qz tx ty tz``, world to camera."""

from __future__ import annotations

from pathlib import Path
from typing import Iterator

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.geometry import se3


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
    """``qw qx qy qz tx ty tz``; :func:`parse_pose` reads it back."""
    quaternion, translation = se3.to_quaternion_translation(cam_from_world)
    return " ".join(f"{number:.10g}" for number in (*quaternion, *translation))


def read_poses(path: str | Path) -> dict[str, Float64Array]:
    """Names and ``cam_from_world``, (4, 4), of a pose file.

    A ninth number (the focal length of the 7-Scenes pseudo ground truth) is ignored, and
    so are empty lines and lines that begin with ``#``.

    Raises:
        PoseError: the file cannot be read, a line has another form, or a name comes twice.
    """
    poses: dict[str, Float64Array] = {}
    for number, line in _lines(Path(path)):
        name, *words = line.split()
        if len(words) not in (7, 8):
            raise PoseError(
                f"{path}, line {number}: expected 'name qw qx qy qz tx ty tz', got {line[:60]!r}"
            )
        try:
            cam_from_world = parse_pose(" ".join(words[:7]))
        except PoseError as error:
            raise PoseError(f"{path}, line {number}: {error}") from None
        if name in poses:
            raise PoseError(f"{path}, line {number}: {name} has a pose already")
        poses[name] = cam_from_world
    return poses


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise PoseError(f"pose file {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise PoseError(f"{path} is not a text file of poses") from error
    for number, line in enumerate(text.splitlines(), start=1):
        stripped = line.strip()
        if stripped and not stripped.startswith("#"):
            yield number, stripped
