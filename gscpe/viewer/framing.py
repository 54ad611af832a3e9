# SPDX-License-Identifier: Apache-2.0
"""From where one sees cameras and what they look at."""

from __future__ import annotations

import math

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.viewer.cameras import frustum_corners
from gscpe.viewer.contents import Contents

_MARGIN = 0.92  # of the picture that what must be seen fills
_SEEN = 0.5  # of what cameras see at the typical depth belongs to the picture


def shown_points(contents: Contents) -> Float64Array:
    """(N, 3) corners of all frusta, and the trajectory, map units; the origin where there are
    none."""
    shown = contents.cameras
    corners = [frustum_corners(c.camera, c.cam_from_map, contents.frustum_depth) for c in shown]
    points = np.concatenate([*corners, contents.centres(), np.zeros((0, 3))])
    return points if len(points) else np.zeros((1, 3))


def looked_at(contents: Contents) -> Float64Array:
    """(N, 3) corners of what cameras see, map units; N may be 0."""
    far = [frustum_corners(c.camera, c.cam_from_map, contents.depth)[1:5] for c in contents.cameras]
    return np.array([(1 - _SEEN) * f.mean(axis=0) + _SEEN * f for f in far]).reshape(-1, 3)


def mean_look(contents: Contents) -> Float64Array:
    """(3,) level unit vector: where the cameras look on average."""
    _, along, up = contents.axes
    looking = np.array([c.cam_from_map[2, :3] for c in contents.cameras]).reshape(-1, 3)
    ahead = looking.mean(axis=0) if len(looking) else along
    level = ahead - (ahead @ up) * up
    length = float(np.linalg.norm(level))
    return np.asarray(along if length < 0.2 else level / length)


def upright_rotation(forward: Float64Array, up: Float64Array) -> Float64Array:
    """Camera axes as rows, (3, 3), of a camera that looks along a unit vector, (3,), upright."""
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def framing_pose(
    points: Float64Array, level: Float64Array, elevation: float, up: Float64Array, camera: Camera
) -> Float64Array:
    """``cam_from_map``, (4, 4), of the nearest eye that sees all points.

    Args:
        points: (N, 3), N at least 1.
        level: (3,) level unit vector along which it looks, seen from above.
        elevation: from above, radians.
        up: (3,) unit vector.
        camera: that sees them.
    """
    forward = math.cos(elevation) * level - math.sin(elevation) * up
    rotation = upright_rotation(forward, up)
    turned = points @ rotation.T
    half = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2 * _MARGIN
    # The nearest eye with |x - ex| <= half_x * (z - ez) for all points, and the same for y.
    high = np.max(turned[:, :2] - half * turned[:, 2:], axis=0)
    low = np.min(turned[:, :2] + half * turned[:, 2:], axis=0)
    eye = np.array([*((high + low) / 2), np.min((low - high) / (2 * half))])
    return se3.from_rotation_translation(rotation, -eye)
