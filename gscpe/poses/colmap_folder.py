# SPDX-License-Identifier: Apache-2.0
"""Writes a COLMAP model without points: what COLMAP, pycolmap and trainers of splats open.

https://colmap.github.io/format.html#binary-file-format. Binary, because names are cut at
blanks when COLMAP reads its text files.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import Mapping, Sequence

from gscpe.arrays import Float64Array
from gscpe.errors import OutputError, PoseError
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.output_file import write_file

_MODELS = {
    "PINHOLE": 1,
    "OPENCV": 4,
    "OPENCV_FISHEYE": 5,
    "FULL_OPENCV": 6,
    "THIN_PRISM_FISHEYE": 10,
}
"""COLMAP's numbers of the models that :meth:`Camera.colmap_text` writes."""

COLMAP_FILES = ("cameras.bin", "images.bin", "points3D.bin")
"""What :func:`write_colmap_folder` writes, in its order."""


def write_colmap_folder(
    folder: str | Path, poses: Mapping[str, Float64Array], cameras: Mapping[str, Camera] | None
) -> None:
    """Writes :data:`COLMAP_FILES`; the folder is made as needed.

    Args:
        folder: to write to.
        poses: ``cam_from_world``, (4, 4), by photo.
        cameras: of these photos, and maybe others. Equal cameras have the same id, from 1.

    Raises:
        PoseError: a photo has no camera.
        OutputError: there is a model with other files in the folder, or it cannot be written.
    """
    folder = Path(folder)
    others = [name for name in ("rigs", "frames") if (folder / f"{name}.bin").exists()]
    if others:  # they would be read together with ours
        raise OutputError(
            f"{folder} holds another COLMAP model with {others[0]}.bin; choose another"
        )
    if cameras is None:
        raise PoseError("a COLMAP model needs the cameras of its photos: give a query list")
    ids = camera_ids(poses, cameras)
    images = []
    for number, (name, pose) in enumerate(poses.items(), start=1):
        quaternion, translation = se3.to_quaternion_translation(pose)
        head = struct.pack("<I7dI", number, *quaternion, *translation, ids[cameras[name]])
        images.append(head + os.fsencode(name) + b"\0" + struct.pack("<Q", 0))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        contents: tuple[list[bytes], ...] = (
            [_camera(camera, i) for camera, i in ids.items()],
            images,
            [],
        )
        for name, records in zip(COLMAP_FILES, contents, strict=True):
            _write(folder / name, records)
    except OSError as error:
        raise OutputError(f"{folder} cannot be written: {error.strerror}") from error


def complete_text_model(
    images_txt: str | Path, poses: Mapping[str, Float64Array], cameras: Mapping[str, Camera]
) -> bool:
    """Writes the cameras.txt and an empty points3D.txt that belong to an images.txt, beside it;
    whether it did: not where there is another model's file already.

    Raises:
        PoseError: a photo has no camera.
        OutputError: the files cannot be written.
    """
    folder = Path(images_txt).parent
    stems = ("cameras", "points3D", "rigs", "frames")
    if any((folder / f"{stem}.{kind}").exists() for stem in stems for kind in ("txt", "bin")):
        return False
    ids = camera_ids(poses, cameras)
    lines = [f"{number} {camera.colmap_text()}\n" for camera, number in ids.items()]
    head = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    write_file(folder / "cameras.txt", (head + "".join(lines)).encode())
    write_file(folder / "points3D.txt", b"# no points\n")
    return True


def camera_ids(
    poses: Mapping[str, Float64Array], cameras: Mapping[str, Camera]
) -> dict[Camera, int]:
    """Numbers from 1 of the different cameras, in the order of their first photo.

    Raises:
        PoseError: a photo has no camera.
    """
    ids: dict[Camera, int] = {}
    for name in poses:
        if name not in cameras:
            raise PoseError(f"{name} has a pose, but no camera; add it to the query list")
        ids.setdefault(cameras[name], len(ids) + 1)
    return ids


def _camera(camera: Camera, number: int) -> bytes:
    model, width, height, *words = camera.colmap_text().split()
    head = struct.pack("<IiQQ", number, _MODELS[model], int(width), int(height))
    return head + struct.pack(f"<{len(words)}d", *map(float, words))


def _write(path: Path, records: Sequence[bytes]) -> None:
    write_file(path, struct.pack("<Q", len(records)) + b"".join(records))
