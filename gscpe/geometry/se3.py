# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms as 4x4 float64 matrices, and their tangent vectors.

A tangent vector is ``xi = (translation, rotation)``, (6,) float64, and perturbs
from the left: ``exp(xi) @ b_from_a``. Formulas: Sola, Deray, Atchuthan, "A micro
Lie theory for state estimation in robotics" (2018), section on SE(3).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError

_SMALL_ANGLE = 1e-4
_WIDE = -0.8
"""Cosine of an angle of 143 degrees."""


def _rotations() -> Any:
    """SciPy's Rotation; importing it takes half of what all of gscpe takes."""
    from scipy.spatial.transform import Rotation

    return Rotation


def skew(vector: ArrayLike) -> Float64Array:
    """The (3, 3) matrix with ``skew(a) @ b == cross(a, b)``."""
    x, y, z = np.asarray(vector, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _left_jacobian(rotation_vector: Float64Array) -> Float64Array:
    """The (3, 3) left Jacobian of SO(3), which couples rotation into translation."""
    angle = float(np.linalg.norm(rotation_vector))
    k = skew(rotation_vector)
    if angle < _SMALL_ANGLE:
        return np.asarray(np.eye(3) + 0.5 * k + k @ k / 6.0)
    a = (1.0 - np.cos(angle)) / angle**2
    b = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + a * k + b * (k @ k))


def exp(xi: ArrayLike) -> Float64Array:
    """The (4, 4) transform of a tangent vector ``xi = (translation, rotation)``, (6,)."""
    xi = np.asarray(xi, dtype=np.float64)
    jacobian = _left_jacobian(xi[3:])
    transform = np.eye(4)
    transform[:3, :3] += skew(xi[3:]) @ jacobian  # the Jacobian is the integral of exp(s [w]x)
    transform[:3, 3] = jacobian @ xi[:3]
    return transform


def log(transform: ArrayLike) -> Float64Array:
    """The tangent vector, (6,), of a (4, 4) transform; the inverse of :func:`exp`."""
    transform = np.asarray(transform, dtype=np.float64)
    rotation_vector = _rotation_vector(transform[:3, :3])
    translation = np.linalg.solve(_left_jacobian(rotation_vector), transform[:3, 3])
    return np.concatenate([translation, rotation_vector])


def _rotation_vector(rotation: Float64Array) -> Float64Array:
    """(3,) of a (3, 3) rotation matrix."""
    a, b, c = rotation.tolist()
    sines = 0.5 * (c[1] - b[2]), 0.5 * (a[2] - c[0]), 0.5 * (b[0] - a[1])
    sine, cosine = math.hypot(*sines), 0.5 * (a[0] + b[1] + c[2] - 1.0)
    if cosine < _WIDE:
        return np.asarray(_rotations().from_matrix(rotation).as_rotvec())
    # Faster than SciPy, which is as exact; towards half a turn, the sines lose the axis.
    scale = math.atan2(sine, cosine) / sine if sine > 1e-12 else 1.0
    return scale * np.array(sines)


def adjoint(transform: ArrayLike) -> Float64Array:
    """The (6, 6) matrix with ``T @ exp(xi) == exp(adjoint(T) @ xi) @ T``."""
    transform = np.asarray(transform, dtype=np.float64)
    rotation = transform[:3, :3]
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = rotation
    result[:3, 3:] = skew(transform[:3, 3]) @ rotation
    return result


def inverse(transform: ArrayLike) -> Float64Array:
    """``a_from_b`` of a rigid ``b_from_a``, (4, 4), without a general inversion."""
    transform = np.asarray(transform, dtype=np.float64)
    result = np.eye(4)
    result[:3, :3] = transform[:3, :3].T
    result[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return result


def nearest_rigid(transform: ArrayLike) -> Float64Array:
    """The transform with the rotation that is nearest to its own, (4, 4): products of many
    transforms and of their transposes drift away from rotations, faster and faster."""
    result = np.array(transform, dtype=np.float64)
    left, _, right = np.linalg.svd(result[:3, :3])
    result[:3, :3] = left @ right
    return result


def from_rotation_translation(rotation: ArrayLike, translation: ArrayLike) -> Float64Array:
    """A (4, 4) transform of a (3, 3) rotation matrix and a (3,) translation."""
    transform = np.eye(4)
    transform[:3, :3] = np.asarray(rotation, dtype=np.float64)
    transform[:3, 3] = np.asarray(translation, dtype=np.float64)
    return transform


def from_quaternion_translation(quaternion_wxyz: ArrayLike, translation: ArrayLike) -> Float64Array:
    """A (4, 4) transform of a quaternion ``(qw, qx, qy, qz)`` and a (3,) translation.

    The quaternion need not be normalized.

    Raises:
        PoseError: a number is not finite, or the quaternion is zero.
    """
    quaternion_wxyz = np.asarray(quaternion_wxyz, dtype=np.float64)
    translation = np.asarray(translation, dtype=np.float64)
    if not (np.all(np.isfinite(quaternion_wxyz)) and np.all(np.isfinite(translation))):
        raise PoseError("a pose holds a number that is not finite")
    if np.linalg.norm(quaternion_wxyz) < 1e-6:
        raise PoseError("a pose holds a quaternion of length zero; expected qw qx qy qz")
    rotation = _rotations().from_quat(quaternion_wxyz, scalar_first=True).as_matrix()
    return from_rotation_translation(rotation, translation)


def to_quaternion_translation(transform: ArrayLike) -> tuple[Float64Array, Float64Array]:
    """The quaternion ``(qw, qx, qy, qz)`` with ``qw >= 0`` and the (3,) translation."""
    transform = np.asarray(transform, dtype=np.float64)
    quaternion = (
        _rotations().from_matrix(transform[:3, :3]).as_quat(canonical=True, scalar_first=True)
    )
    return np.asarray(quaternion, dtype=np.float64), transform[:3, 3].copy()


def check_transform(transform: ArrayLike, name: str) -> Float64Array:
    """The transform as a (4, 4) float64 array, if it is rigid to 1e-4.

    Raises:
        PoseError: the shape, the last row or the rotation is wrong. The message
            carries ``name``, which should say the frames.
    """
    try:
        matrix = np.asarray(transform, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise PoseError(f"{name} must be a 4x4 matrix of numbers ({error})") from None
    if matrix.shape != (4, 4):
        raise PoseError(f"{name} must be a 4x4 matrix, not an array of shape {matrix.shape}")
    if not np.all(np.isfinite(matrix)):
        raise PoseError(f"{name} holds a number that is not finite")
    rotation = matrix[:3, :3]
    orthonormal = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
    if not orthonormal or np.linalg.det(rotation) < 0 or not np.allclose(matrix[3], [0, 0, 0, 1]):
        raise PoseError(
            f"{name} is not a rigid transform (rotation, translation, last row 0 0 0 1)"
        )
    return matrix
