# SPDX-License-Identifier: Apache-2.0
"""Poses that files hold as 4x4 matrices, camera to world."""

from __future__ import annotations

from pathlib import Path
from typing import Mapping

import numpy as np
from numpy.typing import ArrayLike

from gscpe.arrays import Float64Array
from gscpe.datasets.files import parse_numbers, read_text
from gscpe.errors import DatasetError
from gscpe.geometry.se3 import from_rotation_translation, inverse

_ROTATION_TOLERANCE = 1e-3


def invert_pose(world_from_cam: ArrayLike, where: str) -> Float64Array:
    """``cam_from_world``, (4, 4), of a (4, 4) camera-to-world matrix, or of its first 3 rows.

    Files round: the rotation is replaced by the nearest exact one, at most 1e-3 away.

    Raises:
        DatasetError: the matrix is not finite or not rigid; ``where`` begins the message.
    """
    try:
        matrix = np.asarray(world_from_cam, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, (0.0, 0.0, 0.0, 1.0)])
    # 1e15: beyond it, sums of products of coordinates say nothing any more.
    if matrix.shape != (4, 4) or not np.all(np.abs(matrix) < 1e15):
        raise DatasetError(f"{where}: not a 4x4 matrix of finite numbers")
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    rotation = u @ vt
    deviation = max(
        float(np.abs(rotation - matrix[:3, :3]).max()),
        float(np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max()),
    )
    if deviation > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise DatasetError(f"{where}: not a rigid transform (rotation, translation, row 0 0 0 1)")
    return inverse(from_rotation_translation(rotation, matrix[:3, 3]))


def read_matrix_poses(paths: Mapping[str, Path], source: str) -> dict[str, Float64Array]:
    """Name -> ``cam_from_world`` of the files with a usable 4x4 camera-to-world matrix.

    Trackers write matrices that are not finite where they were lost; these are left out, and so
    are missing and damaged files.
    """
    poses = {}
    for name, path in paths.items():
        try:
            words = read_text(path, source).split()
            count = 12 if len(words) == 12 else 16  # KITTI's have three rows
            numbers = parse_numbers(words, count, str(path), "16 numbers of a 4x4 matrix")
            poses[name] = invert_pose(np.reshape(numbers, (-1, 4)), str(path))
        except DatasetError:
            continue
    return poses
