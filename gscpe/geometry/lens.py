# SPDX-License-Identifier: Apache-2.0
"""Where a lens images a direction: OpenCV's rational distortion and COLMAP's fisheye models."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import BoolArray, Float64Array
from gscpe.geometry.camera import Camera


def image_of_directions(camera: Camera, directions: Float64Array) -> tuple[Float64Array, BoolArray]:
    """Pixels, (N, 2), of directions in the camera frame, (N, 3), distortion included, and which of
    them the model images at all, (N,).

    A fisheye images angles from the axis up to where its polynomial begins to fall; a direction
    beyond that, or for other lenses one behind the camera, is imaged nowhere (or twice).

    Models: OpenCV's ``projectPoints`` (FULL_OPENCV), and COLMAP's THIN_PRISM_FISHEYE, of which
    OpenCV's fisheye (Kannala and Brandt, 2006) is the case without tangential and prism terms.
    """
    x, y, z = np.asarray(directions, dtype=np.float64).T
    if not camera.fisheye:
        ahead = z > 0
        depth = np.where(ahead, z, 1.0)
        u, v = _rational(camera.distortion or (0.0,) * 8, x / depth, y / depth)
        seen = ahead
    else:
        radius = np.hypot(x, y)
        angle = np.arctan2(radius, z)
        per_radius = np.where(radius > 0, angle / np.where(radius > 0, radius, 1.0), 1.0)
        u, v = _fisheye(camera.distortion or (0.0,) * 8, x * per_radius, y * per_radius)
        seen = angle < widest_angle(camera)
    pixels = np.stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy], axis=1)
    return pixels, np.asarray(seen)


def widest_angle(camera: Camera) -> float:
    """Of a fisheye, radians from the axis: where a wider angle is no longer imaged farther out."""
    k1, k2, _, _, k3, k4, _, _ = camera.distortion or (0.0,) * 8
    angles = np.linspace(0.0, np.pi, 721)
    squares = angles**2
    slope = 1 + squares * (3 * k1 + squares * (5 * k2 + squares * (7 * k3 + squares * 9 * k4)))
    falls = np.flatnonzero(slope <= 0)
    return float(angles[falls[0]]) if len(falls) else float(np.pi)


def _rational(
    distortion: tuple[float, ...], x: Float64Array, y: Float64Array
) -> tuple[Float64Array, Float64Array]:
    k1, k2, p1, p2, k3, k4, k5, k6 = distortion
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
    return u, v


def _fisheye(
    distortion: tuple[float, ...], x: Float64Array, y: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """``x, y``: the direction in the image times the angle from the axis."""
    k1, k2, p1, p2, k3, k4, sx1, sy1 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + sx1 * r2
    v = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y) + sy1 * r2
    return u, v
