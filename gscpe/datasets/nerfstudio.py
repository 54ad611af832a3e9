# SPDX-License-Identifier: Apache-2.0
"""transforms.json of nerfstudio and instant-ngp, and the Blender scenes of NeRF.

https://docs.nerf.studio/quickstart/data_conventions.html
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.datasets.assembly import make_dataset
from gscpe.datasets.dataset import Dataset
from gscpe.datasets.files import number_at, read_text
from gscpe.datasets.matrix_pose import invert_pose
from gscpe.datasets.photos import (
    common_parent,
    image_size,
    photo_on_disk,
    photos_on_disk,
    relative_name,
)
from gscpe.datasets.split import every_nth, every_nth_text
from gscpe.errors import CameraError, DatasetError
from gscpe.geometry.camera import Camera
from gscpe.given import parse_json
from gscpe.photos.photo_name import with_slashes

NAME = "nerfstudio"
SOURCE = "ns-process-data or instant-ngp's colmap2nerf.py"
_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
# OpenGL cameras look along -z with y up, ours along +z with y down.
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class _Frame:
    """One photo: its path as written, its values over the file's, and where they stand."""

    path: str
    values: Mapping[str, Any]
    where: str


def read_transforms(
    path: str | Path, every: int | None = None, metres_per_unit: float | None = None
) -> Dataset:
    """The photos of a transforms.json, or of the folder that holds it.

    Poses are 4x4 (or 3x4) camera to world with OpenGL axes. Photos without a usable one (NaN) are
    left out, with one logged warning. They are not changed: nerfstudio has turned (and may have
    moved) the world and says how in ``applied_transform``; the splat must be in the same frame,
    which its exporter decides.

    Queries are ``test_filenames`` where the file has such a list, and references then
    ``train_filenames`` (or all others); else, or where ``every`` is given, every n-th photo is a
    query (8 if None). A folder with transforms_train.json and transforms_test.json instead
    (Blender scenes) is split by these.

    Intrinsics ``fl_x, fl_y, cx, cy, w, h, k1, k2, k3, p1, p2`` are of the file or of a frame;
    ``camera_angle_x`` can replace ``fl_x``, each photo's own size ``w, h``, and the image centre
    ``cx, cy``. Pixels are COLMAP's.

    Args:
        every: see above.
        metres_per_unit: of the poses; None: unknown.

    Raises:
        DatasetError: the file is missing or has another form, or the lens is a fisheye.
        SettingsError: ``every`` is below 2.
    """
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    files = [path / "transforms.json" if path.is_dir() else path]
    blender = [folder / "transforms_train.json", folder / "transforms_test.json"]
    split_by_file = path.is_dir() and not files[0].is_file() and blender[0].is_file()
    if split_by_file:
        files = blender
    trees = [_read_json(file) for file in files]
    by_file = [_frames(tree, file) for tree, file in zip(trees, files, strict=True)]
    frames = {frame.path: frame for frames in by_file for frame in frames}
    on_disk = photos_on_disk(folder, frames, f"{files[0]} (file_path)")
    parent = common_parent(folder, *(folder / there for there in on_disk.values()))
    names = {listed: relative_name(parent, folder / there) for listed, there in on_disk.items()}
    frames = {names[listed]: frame for listed, frame in frames.items() if listed in names}

    if split_by_file and every is None:
        queries = frozenset(names[f.path] for f in by_file[1] if f.path in names)
        split = "the file's"
    elif "test_filenames" in trees[0] and every is None:
        queries = _listed(trees[0], "test_filenames", files[0], names)
        split = "the file's"
        if "train_filenames" in trees[0]:
            kept = queries | _listed(trees[0], "train_filenames", files[0], names)
            frames = {name: frame for name, frame in frames.items() if name in kept}
    else:
        queries, split = every_nth(frames, every), every_nth_text(every)
    # Each photo's own: portraits and landscapes lie in one folder.
    sizes = {name: image_size(parent / name) for name, f in frames.items() if _is_sizeless(f)}
    return make_dataset(
        name=NAME,
        scene=folder.absolute().name,
        image_folder=parent,
        cameras={name: _camera(frame, sizes.get(name)) for name, frame in frames.items()},
        truths={"transforms": _poses(frames)},
        queries=queries,
        metres_per_unit=metres_per_unit,
        split=split,
    )


def _read_json(path: Path) -> Mapping[str, Any]:
    try:
        tree = parse_json(read_text(path, SOURCE))
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{path} is not a JSON file: {error}") from None
    if not isinstance(tree, dict):
        raise DatasetError(f"{path} is not a transforms.json: it does not hold a JSON object")
    return tree


def _frames(tree: Mapping[str, Any], path: Path) -> list[_Frame]:
    frames = tree.get("frames")
    if not isinstance(frames, list) or not frames:
        raise DatasetError(f"{path}: frames is missing or empty")
    common = {key: value for key, value in tree.items() if key != "frames"}
    result = []
    for i, frame in enumerate(frames):
        name = frame.get("file_path") if isinstance(frame, dict) else None
        if not isinstance(name, str) or not name:
            raise DatasetError(f"{path}, frame {i}: file_path is missing")
        where = f"{path}, frame {i} ({name})"
        result.append(_Frame(_name(path.parent, name), common | frame, where))
    return result


def _listed(
    tree: Mapping[str, Any], key: str, path: Path, names: Mapping[str, str]
) -> frozenset[str]:
    """Names of the photos of a split list."""
    listed = tree[key]
    if not isinstance(listed, list):
        raise DatasetError(f"{path}: {key} is not a list of names")
    there = (_name(path.parent, name) for name in listed if isinstance(name, str))
    return frozenset(names[name] for name in there if name in names)


def _name(folder: Path, listed: str) -> str:
    """As listed, or with ``/`` for the backslashes of Windows; Blender scenes leave the ending."""
    return listed if photo_on_disk(folder, listed) else with_slashes(listed)


def _poses(frames: Mapping[str, _Frame]) -> dict[str, Float64Array]:
    """The usable poses; recorders write NaN where tracking was lost.

    Raises:
        DatasetError: none is usable; the message is about the first.
    """
    poses, wrong = {}, []
    for name, frame in frames.items():
        try:
            poses[name] = _pose(frame)
        except DatasetError as error:
            wrong.append(error)
    if wrong and not poses:
        raise wrong[0]
    return poses


def _pose(frame: _Frame) -> Float64Array:
    world_from_opengl = frame.values.get("transform_matrix")
    if world_from_opengl is None:
        raise DatasetError(f"{frame.where}: transform_matrix is missing")
    opengl_from_world = invert_pose(world_from_opengl, f"{frame.where}: transform_matrix")
    return np.asarray(_OPENGL_FROM_OPENCV.T @ opengl_from_world)


def _is_sizeless(frame: _Frame) -> bool:
    return "w" not in frame.values or "h" not in frame.values


def _camera(frame: _Frame, size: tuple[int, int] | None) -> Camera:
    """``size`` of the photo stands in where the frame says none."""
    values = frame.values
    model = str(values.get("camera_model", "OPENCV")).upper()
    if model not in _MODELS or values.get("is_fisheye"):
        model = "fisheye" if values.get("is_fisheye") else model
        raise DatasetError(
            f"{frame.where}: camera model {model} is not supported (supported: "
            f"{', '.join(_MODELS)}); undistort the photos to PINHOLE first"
        )

    def value(key: str, default: float | None = None) -> float:
        return number_at(values, key, frame.where, default)

    width, height = value("w", size and size[0]), value("h", size and size[1])
    if not all(1 <= length <= 1e6 and length == int(length) for length in (width, height)):
        raise DatasetError(f"{frame.where}: w, h = {width}, {height} is not a possible image size")
    if value("k4", 0.0) != 0.0:
        # Its k4 multiplies r^8; the k4 of OpenCV is another thing.
        raise DatasetError(f"{frame.where}: k4 is not supported; undistort the photos first")
    fx = value("fl_x") if "fl_x" in values else _focal(value("camera_angle_x"), width)
    if "fl_y" in values:
        fy = value("fl_y")
    else:
        fy = _focal(value("camera_angle_y"), height) if "camera_angle_y" in values else fx
    centre = [value("cx", width / 2), value("cy", height / 2)]
    distortion = [value(key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3")]
    try:
        return Camera.from_colmap(
            "FULL_OPENCV", int(width), int(height), [fx, fy, *centre, *distortion, 0.0, 0.0, 0.0]
        )
    except CameraError as error:
        raise DatasetError(f"{frame.where}: {error}") from None


def _focal(angle: float, length: float) -> float:
    """Pixels of the focal length with this field of view, radians, over ``length`` pixels."""
    if not 0.0 < angle < math.pi:
        raise DatasetError(f"a field of view of {angle} radians is not possible for a pinhole")
    return length / (2.0 * math.tan(angle / 2.0))
