# SPDX-License-Identifier: Apache-2.0
"""Reads the files of a COLMAP model, binary or text, as far as poses and cameras go.

https://colmap.github.io/format.html. Read here and not by pycolmap, because that cuts names at
blanks in text files, wants points3D, and does not run on every machine. Since COLMAP 3.12
poses are those of rigs (frames, rigs); the poses of the photos are in images.bin still.
"""

from __future__ import annotations

import mmap
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Iterator

from gscpe.arrays import Float64Array
from gscpe.errors import CameraError, ColmapModelError, PoseError
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.photos.text_file import read_text_file
from gscpe.poses.colmap_images import image_lines

MODELS = (
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
)
"""COLMAP's camera models in the order of their numbers, and how many parameters each has."""


@dataclass(frozen=True)
class ColmapCamera:
    """A camera of any of COLMAP's models, as the file says it."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class ColmapImage:
    """A registered photo: its id, name, ``cam_from_world``, (4, 4), and the id of its camera."""

    image_id: int
    name: str
    cam_from_world: Float64Array
    camera_id: int


def read_colmap_files(folder: Path) -> tuple[dict[int, ColmapCamera], list[ColmapImage]]:
    """The cameras by id and the registered photos of a model; binary files where there are both.

    Raises:
        ColmapModelError: a file is missing, cannot be read, or is damaged.
    """
    if not folder.is_dir():
        raise ColmapModelError(f"{folder} is not a folder; give the one with cameras.bin")
    if not any((folder / f"cameras.{kind}").is_file() for kind in ("bin", "txt")):
        raise ColmapModelError(f"{folder} has no cameras.bin or cameras.txt; is it sparse/0?")
    for kind, cameras_of, images_of in (
        ("bin", _binary_cameras, _binary_images),
        ("txt", _text_cameras, _text_images),
    ):
        paths = folder / f"cameras.{kind}", folder / f"images.{kind}"
        if not all(path.is_file() for path in paths):
            continue
        try:
            return dict(cameras_of(paths[0])), list(images_of(paths[1]))
        except OSError as error:
            raise ColmapModelError(f"{error.filename} cannot be read: {error.strerror}") from error
        except PoseError as error:
            raise ColmapModelError(f"{folder} is not a readable COLMAP model: {error}") from None
    raise ColmapModelError(
        f"{folder} is not a complete COLMAP model: it needs cameras.bin and images.bin, or "
        "cameras.txt and images.txt"
    )


def to_camera(camera: ColmapCamera, where: str) -> Camera:
    """The camera in our words.

    Raises:
        CameraError: its model is not supported, or a value is impossible; ``where`` begins the
            message.
    """
    try:
        return Camera.from_colmap(camera.model, camera.width, camera.height, camera.parameters)
    except CameraError as error:
        raise CameraError(f"{where}: {error}") from None


def _text_cameras(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    for number, line in enumerate(_text(path).split("\n"), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            parameters = tuple(map(float, words[4:]))
            camera = ColmapCamera(words[1], int(words[2]), int(words[3]), parameters)
            yield int(words[0]), camera
        except (IndexError, ValueError):
            raise ColmapModelError(
                f"{path}, line {number}: expected 'CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]', "
                f"got {line[:60]!r}"
            ) from None


def _text_images(path: Path) -> Iterator[ColmapImage]:
    for line in image_lines(_text(path), str(path)):
        yield ColmapImage(line.image_id, line.name, line.cam_from_world(), line.camera_id)


def _text(path: Path) -> str:
    try:
        return read_text_file(path)
    except UnicodeDecodeError as error:
        raise ColmapModelError(f"{path} is not a text file; copy it again") from error


class _Reader:
    """Little-endian values of a file, one after the other; what is cut off is damaged."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as file:
            if os.fstat(file.fileno()).st_size < 8:
                raise ColmapModelError(f"{path} is damaged: it is empty; copy it again")
            # Mapped: of large models, nearly all is points that are skipped.
            self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._at = 0

    def values(self, form: str) -> tuple[int | float, ...]:
        try:
            values = struct.unpack_from(f"<{form}", self._data, self._at)
        except struct.error:
            raise self.damaged("it ends too early") from None
        self._at += struct.calcsize(f"<{form}")
        return values

    def name(self) -> str:
        end = self._data.find(b"\0", self._at)
        if end == -1:
            raise self.damaged("it ends too early")
        name = os.fsdecode(self._data[self._at : end])
        self._at = end + 1
        return name

    def skip(self, count: int) -> None:
        self._at += count
        if self._at > len(self._data):
            raise self.damaged("it ends too early")

    def damaged(self, how: str) -> ColmapModelError:
        return ColmapModelError(f"{self._path} is damaged: {how}; copy it again")


def _binary_cameras(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    reader = _Reader(path)
    for _ in range(int(reader.values("Q")[0])):
        number, key, width, height = map(int, reader.values("IiQQ"))
        if not 0 <= key < len(MODELS):
            raise ColmapModelError(
                f"{path}: a camera has the unknown model number {key}; undistort "
                "the photos to PINHOLE first, or write the model as text"
            )
        model, count = MODELS[key]
        yield number, ColmapCamera(model, width, height, reader.values(f"{count}d"))


def _binary_images(path: Path) -> Iterator[ColmapImage]:
    reader = _Reader(path)
    for _ in range(int(reader.values("Q")[0])):
        image_id, *numbers, camera_id = reader.values("I7dI")
        name = reader.name()
        reader.skip(24 * int(reader.values("Q")[0]))
        try:
            pose = se3.from_quaternion_translation(numbers[:4], numbers[4:])
        except PoseError as error:
            raise ColmapModelError(f"{path}, {name}: {error}") from None
        yield ColmapImage(int(image_id), name, pose, int(camera_id))
