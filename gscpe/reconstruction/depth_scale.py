# SPDX-License-Identifier: Apache-2.0
"""The unit of a model from depth images that belong to some of its photos (RGB-D cameras)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import ReconstructionError
from gscpe.geometry.similarity_transform import Similarity
from gscpe.photos.photo_name import named_like

_LEAST_POINTS = 50
_MOST_SCATTER = 0.1  # half of the ratios are within this of the median, relative
_EDGE = 0.05  # relative step of depth beside a pixel that is not believed
_UNKNOWN = (0, 65535)


def scaled_by_depth(model: Any, folder: Path, per_metre: float) -> Similarity:
    """The scaling of a model to metres: the median, over the points that photos see, of the depth
    that was measured to the depth that they have in the model.

    Args:
        model: pycolmap.Reconstruction.
        folder: of 16-bit depth images, named like the photos and seen by the same camera; they may
            be smaller or larger. 0 and 65535: not known.
        per_metre: what a metre is in them; 1000 for millimetres.

    Raises:
        ReconstructionError: there are none, they are something else, or they do not fit the model.
    """
    ratios, used, looked_for = [], 0, ""
    for image in sorted(model.images.values(), key=lambda image: str(image.name)):
        if not image.has_pose:
            continue
        looked_for = looked_for or str(image.name)
        path = named_like(folder, str(image.name))
        if path is None:
            continue
        used += 1
        depth = read_depth(path, image.camera.width, image.camera.height) / per_metre
        ratios.append(_ratios(model, image, depth))
    if not used:
        raise no_depth_images(folder, looked_for)
    all_ = np.concatenate(ratios)
    if len(all_) < _LEAST_POINTS:
        raise ReconstructionError(
            f"the {used} depth images in {folder} tell the depth of {len(all_)} points, and at "
            f"least {_LEAST_POINTS} are needed"
        )
    scale = float(np.median(all_))
    scatter = float(np.median(np.abs(all_ / scale - 1.0)))
    if scatter > _MOST_SCATTER:
        raise ReconstructionError(
            f"the depth images in {folder} do not fit the model: half of {len(all_)} points are "
            f"more than {scatter:.0%} off. Are they of these very photos, seen from the colour "
            "camera, as 16-bit PNG?"
        )
    return Similarity(scale, np.eye(3), np.zeros(3))


def no_depth_images(folder: Path, photo: str) -> ReconstructionError:
    """The error where a folder has none of any photo; ``photo`` is the name of one."""
    return ReconstructionError(
        f"{folder} has no depth image of the photos; they are named like them, for example "
        f"{Path(photo).with_suffix('.png')}"
    )


def read_depth(path: Path, width: int, height: int) -> Float64Array:
    """A depth image, (H, W), as it is stored; NaN where it is not known.

    Raises:
        ReconstructionError: it is something else, or of another shape than its photo, whose width
            and height are given.
    """
    data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    depth = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    if depth is None or depth.ndim != 2 or depth.dtype != np.uint16:
        raise ReconstructionError(f"{path} is not a depth image: a grey PNG of 16 bits")
    if abs(depth.shape[1] * height - depth.shape[0] * width) > 2 * max(depth.shape):
        raise ReconstructionError(
            f"{path} is {depth.shape[1]}x{depth.shape[0]}, but its photo is {width}x{height}: the "
            "shapes differ, so it is not seen by the same camera"
        )
    return np.where(np.isin(depth, _UNKNOWN), np.nan, depth.astype(np.float64))


def _ratios(model: Any, image: Any, depth: Float64Array) -> Float64Array:
    """Of what a photo sees: metres a unit of the model."""
    pose = image.cam_from_world().matrix()
    seen = [point for point in image.points2D if point.has_point3D()]
    if not seen:
        return np.zeros(0)
    pixels = np.array([point.xy for point in seen])
    points = np.array([model.points3D[point.point3D_id].xyz for point in seen])
    z = points @ pose[2, :3] + pose[2, 3]
    size = np.array([image.camera.width, image.camera.height])
    column, row = (pixels / size * depth.shape[::-1]).astype(np.int64).T
    inside = (row > 0) & (row < depth.shape[0] - 1) & (column > 0) & (column < depth.shape[1] - 1)
    inside &= z > 0
    row, column, z = row[inside], column[inside], z[inside]
    around = np.stack(
        [depth[row + dy, column + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)], axis=1
    )
    smooth = np.ptp(around, axis=1) < _EDGE * around[:, 4]  # false for NaN
    return np.asarray(around[smooth, 4] / z[smooth])
