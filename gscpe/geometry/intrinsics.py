# SPDX-License-Identifier: Apache-2.0
"""Small changes of a camera: five numbers, in which its uncertainty is given too.

    ln(f), ln(fy / fx), cx / fx, cy / fy, k1

where f is the geometric mean of both focal lengths, and k1 of COLMAP's SIMPLE_RADIAL and OpenCV.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.camera import Camera

FOCAL, ASPECT, PRINCIPAL_X, PRINCIPAL_Y, RADIAL = range(5)


def changed_camera(camera: Camera, change: Float64Array) -> Camera:
    """A camera that is no fisheye after a change, (5,)."""
    focal, aspect, right, down, radial = (float(number) for number in change)
    k1, *others = camera.distortion or (0.0,) * 8
    distortion = (k1 + radial, *others)
    return replace(
        camera,
        fx=camera.fx * float(np.exp(focal - 0.5 * aspect)),
        fy=camera.fy * float(np.exp(focal + 0.5 * aspect)),
        cx=camera.cx + right * camera.fx,
        cy=camera.cy + down * camera.fy,
        distortion=distortion if any(distortion) else (),
    )


def moved_by_intrinsics(x: Float64Array, y: Float64Array) -> Float64Array:
    """How each of the five numbers moves pixels of a pinhole camera, (5, 2, N), in focal lengths,
    at directions x, y, (N,), which are x / z, y / z in the camera frame."""
    moved = np.zeros((5, 2, len(x)), x.dtype)
    squared = x * x + y * y
    moved[FOCAL] = x, y
    moved[ASPECT] = -0.5 * x, 0.5 * y
    moved[PRINCIPAL_X, 0] = moved[PRINCIPAL_Y, 1] = 1.0
    moved[RADIAL] = x * squared, y * squared
    return moved
