# SPDX-License-Identifier: Apache-2.0
"""How sure a position is, as an ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array, IntArray
from gscpe.geometry import se3
from gscpe.geometry.pose_error import camera_centre


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """One standard deviation of a camera centre.

    Attributes:
        name: of the photo.
        centre: (3,) of the camera, map units.
        quaternion: (4,) w, x, y, z of its axes in the map.
        radii: (3,) standard deviations along the axes, map units.
    """

    name: str
    centre: Float64Array
    quaternion: Float64Array
    radii: Float64Array


def centre_ellipsoid(
    name: str, cam_from_map: Float64Array, covariance: Float64Array, scale: float = 1.0
) -> Ellipsoid:
    """Of a pose's camera centre.

    ``exp(xi) @ cam_from_map`` moves the centre by ``-R^T rho`` for a small xi = (rho, omega), so
    its covariance is that of rho, turned into the map.

    Args:
        name: of the photo.
        cam_from_map: (4, 4).
        covariance: (6, 6) of xi, (translation, rotation), world units and radians.
        scale: map units per world unit.
    """
    rotation = cam_from_map[:3, :3]
    turned = scale**2 * rotation.T @ covariance[:3, :3] @ rotation
    variances, axes = np.linalg.eigh((turned + turned.T) / 2)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    turn = se3.from_rotation_translation(axes, [0, 0, 0])
    return Ellipsoid(
        name,
        camera_centre(cam_from_map),
        se3.to_quaternion_translation(turn)[0],
        np.sqrt(np.maximum(variances, 0.0)),
    )


def sphere_mesh(rings: int = 8, sides: int = 16) -> tuple[Float64Array, IntArray]:
    """Corners, (V, 3), and triangles, (F, 3), of a sphere of radius 1, seen from outside."""
    polar = np.linspace(0, np.pi, rings + 1)
    around = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    theta, phi = (grid.ravel() for grid in np.meshgrid(polar, around, indexing="ij"))
    corners = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1
    )
    triangles = []
    for ring in range(rings):
        for side in range(sides):
            a, b = ring * sides + side, ring * sides + (side + 1) % sides
            c, d = a + sides, b + sides
            triangles += [(a, c, b), (b, c, d)]
    return corners, np.array(triangles)
