# SPDX-License-Identifier: Apache-2.0
"""Where cameras are, and how far two of their poses are apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gscpe.arrays import Float64Array


@dataclass(frozen=True)
class PoseDifference:
    """Distance of the camera centres (world units) and angle between the rotations (degrees)."""

    distance: float
    degrees: float


def camera_centre(cam_from_world: ArrayLike) -> Float64Array:
    """Where the camera is in the world, (3,), in its units."""
    cam_from_world = np.asarray(cam_from_world, dtype=np.float64)
    return np.asarray(-cam_from_world[:3, :3].T @ cam_from_world[:3, 3])


def camera_centres(cam_from_world: ArrayLike) -> Float64Array:
    """As :func:`camera_centre`, of many poses: (N, 3) of (N, 4, 4); N may be 0."""
    poses = np.asarray(cam_from_world, dtype=np.float64).reshape(-1, 4, 4)
    return np.asarray(-np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3]))


def rotation_angle_degrees(rotation: ArrayLike) -> float:
    """The angle of a (3, 3) rotation in degrees; exact for small angles too, unlike arccos."""
    rotation = np.asarray(rotation, dtype=np.float64)
    # |R - I|_F = 2 sqrt(2) sin(angle / 2)
    half_sine = np.linalg.norm(rotation - np.eye(3)) / (2.0 * np.sqrt(2.0))
    return float(np.degrees(2.0 * np.arcsin(min(1.0, float(half_sine)))))


def pose_difference(cam_from_world_a: ArrayLike, cam_from_world_b: ArrayLike) -> PoseDifference:
    """The difference of two world-to-camera poses, (4, 4) each; symmetric in its arguments."""
    a = np.asarray(cam_from_world_a, dtype=np.float64)
    b = np.asarray(cam_from_world_b, dtype=np.float64)
    return PoseDifference(
        distance=float(np.linalg.norm(camera_centre(a) - camera_centre(b))),
        degrees=rotation_angle_degrees(a[:3, :3] @ b[:3, :3].T),
    )
