# SPDX-License-Identifier: Apache-2.0
"""Poses as JSON: our own file of poses, and the details that localizing writes."""

from __future__ import annotations

import json
from typing import Any, Iterator, Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import CameraError, PoseError
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.given import parse_json
from gscpe.poses.hloc import add_pose, parse_pose

FORMAT = "gscpe poses"
VERSION = 1


def parse_json_poses(text: str, source: str) -> tuple[dict[str, Float64Array], dict[str, Camera]]:
    """``cam_from_world``, (4, 4), and cameras, as far as they are given, by photo.

    Photos whose pose is null (in details: not localized) have no pose, but a camera.

    Raises:
        PoseError: the text is no JSON or of another form, a name comes twice, or the poses are in
            several maps, whose worlds may differ.
    """
    poses: dict[str, Float64Array] = {}
    maps: set[str] = set()
    cameras: dict[str, Camera] = {}
    for where, entry in _entries(text, source):
        if not isinstance(entry, dict) or not isinstance(entry.get("name"), str):
            raise PoseError(f'{where}: expected an object with "name" and "cam_from_world"')
        name = entry["name"]
        if "cam_from_world" not in entry:
            raise PoseError(f'{where}: {name} has no "cam_from_world" (4x4, world to camera)')
        if isinstance(entry.get("camera"), str):
            try:
                cameras[name] = Camera.parse(entry["camera"])
            except CameraError as error:
                raise PoseError(f"{where}, {name}: {error}") from None
        if entry["cam_from_world"] is not None:
            maps.add(str(entry.get("map_name", "")))
            add_pose(poses, name, _pose(entry, f"{where}, {name}"), where)
    if len(maps) > 1:
        names = ", ".join(sorted(filter(None, maps)))
        raise PoseError(
            f"{source} holds poses in several maps ({names}), each with a world of its own; read "
            "the pose files of each map"
        )
    return poses, cameras


def format_json_poses(
    poses: Mapping[str, Float64Array], cameras: Mapping[str, Camera] | None
) -> str:
    """The text of a file; matrix, quaternion and translation say the same."""
    entries = []
    for name, cam_from_world in poses.items():
        quaternion, translation = se3.to_quaternion_translation(cam_from_world)
        entry: dict[str, Any] = {
            "name": name,
            "cam_from_world": np.asarray(cam_from_world, dtype=np.float64).tolist(),
            "quaternion_wxyz": quaternion.tolist(),
            "translation": translation.tolist(),
        }
        if cameras is not None and name in cameras:
            entry["camera"] = cameras[name].colmap_text()
        entries.append(entry)
    # A photo a line: a file of thousands can still be looked at.
    body = ",\n".join(json.dumps(entry, allow_nan=False) for entry in entries)
    head = f'{{"format": {json.dumps(FORMAT)}, "version": {VERSION}, "poses": ['
    return f"{head}\n{body}\n]}}\n" if entries else f"{head}]}}\n"


def _entries(text: str, source: str) -> Iterator[tuple[str, Any]]:
    """The objects of a file of poses, a list, one object, or an object a line."""
    try:
        data = parse_json(text)
    except json.JSONDecodeError as error:
        if error.msg != "Extra data":
            raise PoseError(
                f"{source}, line {error.lineno}: not JSON ({error.msg}); is the file complete?"
            ) from None
        yield from _lines(text, source)
        return
    if isinstance(data, dict) and "poses" in data:
        if data.get("format", FORMAT) != FORMAT or data.get("version", VERSION) != VERSION:
            raise PoseError(
                f"{source} has format {data.get('format')!r}, version {data.get('version')!r}; "
                f"expected {FORMAT!r}, version {VERSION}"
            )
        data = data["poses"]
    if not isinstance(data, list):
        data = [data]
    for number, entry in enumerate(data, start=1):
        yield f"{source}, pose {number}", entry


def _lines(text: str, source: str) -> Iterator[tuple[str, Any]]:
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip():
            try:
                yield f"{source}, line {number}", parse_json(line)
            except json.JSONDecodeError as error:
                raise PoseError(
                    f"{source}, line {number}: not JSON ({error.msg}); expected an object a line"
                ) from None


def _pose(entry: Mapping[str, Any], where: str) -> Float64Array:
    given = entry["cam_from_world"]
    if isinstance(given, str):
        try:
            return parse_pose(given)
        except PoseError as error:
            raise PoseError(f"{where}: {error}") from None
    cam_from_world = se3.check_transform(given, f"{where}: cam_from_world")
    if "quaternion_wxyz" in entry and "translation" in entry:
        try:
            words = [float(x) for x in (*entry["quaternion_wxyz"], *entry["translation"])]
        except (TypeError, ValueError):
            words = []
        if len(words) != 7:
            raise PoseError(f"{where}: expected quaternion_wxyz of 4 numbers, translation of 3")
        if not np.allclose(
            se3.from_quaternion_translation(words[:4], words[4:]), cam_from_world, atol=1e-5
        ):
            raise PoseError(f"{where}: quaternion and translation are not those of cam_from_world")
    return cam_from_world
