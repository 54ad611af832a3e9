"""A splat and references under a similarity: turned, scaled and shifted into another frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.similarity_transform import Similarity
from gscpe.scene.gaussians import GaussianScene, far_origin, normalized_quaternions
from gscpe.scene.references import References

_DEGREES = 3


def move_references(references: References, b_from_a: Similarity) -> References:
    """References with respect to a, with respect to b."""
    return replace(references, cam_from_world=b_from_a.cam_from_b(references.cam_from_world))


def move_scene(scene: GaussianScene, b_from_a: Similarity) -> GaussianScene:
    """A splat in frame a, in frame b: means, axes and sizes of the Gaussians are moved, and their
    harmonics are turned, so that renders stay what they were, to rounding."""
    from scipy.spatial.transform import Rotation  # takes longer to import than all else

    rotation, scale = b_from_a.rotation, b_from_a.scale
    turned = Rotation.from_matrix(rotation) * Rotation.from_quat(
        scene.quaternions.astype(np.float64), scalar_first=True
    )
    sh = scene.sh.astype(np.float64)
    for degree in range(1, _DEGREES + 1):
        rows = slice(degree**2, (degree + 1) ** 2)
        if sh[:, rows].shape[1]:
            sh[:, rows] = np.einsum("ij,njk->nik", sh_rotation(rotation, degree), sh[:, rows])
    means = scale * scene.means.astype(np.float64) @ rotation.T
    shift = b_from_a.apply(scene.origin)  # which may be so large that float32 would not do
    middle = np.median(means, axis=0)
    extent = float(np.median(np.linalg.norm(means - middle, axis=1)))
    origin = far_origin(middle + shift, extent)
    return replace(
        scene,
        means=(means + (shift - origin)).astype(np.float32),
        quaternions=normalized_quaternions(turned.as_quat(scalar_first=True)),
        scales=(scale * scene.scales.astype(np.float64)).astype(np.float32),
        sh=sh.astype(np.float32),
        near=scale * scene.near,
        origin=origin,
    )


def sh_rotation(rotation: Float64Array, degree: int) -> Float64Array:
    """How the coefficients of one degree, (2 degree + 1), change when what they describe is turned.

    Functions of one degree stay among themselves when they are turned; so the matrix follows from
    their values in a few directions.
    """
    directions = np.random.default_rng(0).normal(size=(8 * degree + 4, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before = _harmonics(directions @ rotation, degree)  # the directions, turned back
    matrix, *_ = np.linalg.lstsq(_harmonics(directions, degree), before, rcond=None)
    return np.asarray(matrix)


def _harmonics(directions: Float64Array, degree: int) -> Float64Array:
    """Real spherical harmonics of one degree in the order and with the signs of 3DGS, up to the
    factors that all of a degree share: (N, 2 degree + 1) of unit vectors, (N, 3)."""
    x, y, z = directions.T
    if degree == 1:
        return np.stack([-y, z, -x], axis=1)
    if degree == 2:
        root = np.sqrt(3.0)
        return np.stack(
            [
                root * x * y,
                -root * y * z,
                0.5 * (2 * z * z - x * x - y * y),
                -root * x * z,
                0.5 * root * (x * x - y * y),
            ],
            axis=1,
        )
    a, b, c = np.sqrt(5.0 / 8.0), np.sqrt(15.0), np.sqrt(3.0 / 8.0)
    return np.stack(
        [
            -a * y * (3 * x * x - y * y),
            b * x * y * z,
            -c * y * (4 * z * z - x * x - y * y),
            0.5 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -c * x * (4 * z * z - x * x - y * y),
            0.5 * b * z * (x * x - y * y),
            -a * x * (x * x - 3 * y * y),
        ],
        axis=1,
    )
