# SPDX-License-Identifier: Apache-2.0
"""A splat in a world whose axes are turned: centres, rotations and harmonics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gscpe.arrays import Float64Array
from gscpe.geometry.spread import even_directions
from gscpe.splats.gaussians import GaussianScene

Y_AND_Z_NEGATED = np.diag([1.0, -1.0, -1.0])
"""A half turn about x: between the axes of a ``.ply`` and those of many ``.spz`` and ``.sog``."""


def turned(scene: GaussianScene, rotation: ArrayLike) -> GaussianScene:
    """The scene turned about the world's origin: ``rendered(turned, cam_from_world)`` is
    ``rendered(scene, cam_from_world @ rotation)``.

    Args:
        scene: any.
        rotation: (3, 3) rotation matrix; points become ``rotation @ point``.
    """
    from scipy.spatial.transform import Rotation

    matrix = np.asarray(rotation, dtype=np.float64)
    quaternions = Rotation.from_matrix(matrix) * Rotation.from_quat(
        scene.quaternions, scalar_first=True
    )
    sh = scene.sh.copy()
    for degree in range(1, scene.sh_degree + 1):
        band = slice(degree**2, (degree + 1) ** 2)
        by = harmonics_turned(matrix, degree)
        sh[:, band] = np.einsum("ij,njk->nik", by, scene.sh[:, band].astype(np.float64))
    return replace(
        scene,
        means=(scene.means.astype(np.float64) @ matrix.T).astype(np.float32),
        quaternions=quaternions.as_quat(scalar_first=True).astype(np.float32),
        sh=sh,
        origin=matrix @ scene.origin,
    )


def harmonics_turned(rotation: Float64Array, degree: int) -> Float64Array:
    """The (2 degree + 1, 2 degree + 1) matrix that turns the coefficients of a degree 1 to 3.

    Seen along ``rotation @ d`` after, a colour is what it was along ``d`` before. Harmonics of a
    degree turn among themselves, so a few directions determine the matrix (to 1e-15).
    """
    before = even_directions(32)
    after = before @ rotation.T
    matrix = np.linalg.lstsq(_harmonics(after, degree), _harmonics(before, degree), rcond=None)[0]
    return np.asarray(np.where(np.abs(matrix) < 1e-14, 0.0, matrix))


def _harmonics(directions: Float64Array, degree: int) -> Float64Array:
    """Real spherical harmonics of one degree along unit vectors, (N, 2 degree + 1), with the
    order and the signs of 3DGS; a factor that they share is left out."""
    x, y, z = directions.T
    s = np.sqrt
    if degree == 1:
        values = [-y, z, -x]
    elif degree == 2:
        values = [x * y, -y * z, (3 * z * z - 1) / s(12), -x * z, (x * x - y * y) / 2]
    else:
        values = [
            -s(1 / 24) * y * (3 * x * x - y * y),
            x * y * z,
            -s(1 / 40) * y * (5 * z * z - 1),
            s(1 / 60) * z * (5 * z * z - 3),
            -s(1 / 40) * x * (5 * z * z - 1),
            z * (x * x - y * y) / 2,
            -s(1 / 24) * x * (x * x - 3 * y * y),
        ]
    return np.stack(values, axis=1)
