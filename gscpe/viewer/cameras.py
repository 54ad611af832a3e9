# SPDX-License-Identifier: Apache-2.0
"""Cameras as they are drawn: kinds and colours, frusta, and where one flies to see through them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera

Kind = Literal["reference", "truth", "coarse", "aligned", "final"]

KINDS: tuple[Kind, ...] = ("reference", "truth", "coarse", "aligned", "final")
"""In the order in which they are drawn: later ones lie above."""

COLOURS: Mapping[Kind, tuple[int, int, int]] = {
    "reference": (150, 160, 175),
    "truth": (40, 170, 90),
    "coarse": (240, 150, 20),
    "aligned": (190, 70, 200),
    "final": (30, 110, 240),
}

TITLES: Mapping[Kind, str] = {
    "reference": "reference",
    "truth": "true pose",
    "coarse": "coarse pose",
    "aligned": "aligned pose",
    "final": "final pose",
}

TRAJECTORY = (225, 45, 65)
"""Colour of a trajectory."""

EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1), (5, 6))
"""Between the corners of a frustum; the last is the tick that says where up is."""


@dataclass(frozen=True, eq=False)
class ShownCamera:
    """A camera that is drawn.

    Attributes:
        kind: see COLOURS.
        name: of its photo.
        cam_from_map: (4, 4) float64, map units.
        camera: that took the photo.
        trusted: False for the coarse or aligned pose of a photo that was not localized.
    """

    kind: Kind
    name: str
    cam_from_map: Float64Array
    camera: Camera
    trusted: bool = True


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """Where somebody looks from.

    Attributes:
        position: (3,) of the eye, map units.
        quaternion: (4,) w, x, y, z of its axes in the map; x right, y down, z ahead.
        vertical_angle: that the window shows, radians.
    """

    position: Float64Array
    quaternion: Float64Array
    vertical_angle: float


@dataclass(frozen=True, eq=False)
class PhotoPlane:
    """Where a photo lies before its camera, in the camera's frame.

    Attributes:
        centre: (3,) of the photo.
        width, height: of it.
    """

    centre: Float64Array
    width: float
    height: float


def frustum_corners(camera: Camera, cam_from_map: Float64Array, depth: float) -> Float64Array:
    """(7, 3) points in the map: the camera centre, the corners of the picture at this depth (from
    the top left, clockwise), and both ends of the tick above it. See EDGES."""
    pinhole = camera.without_distortion()
    left, right = -pinhole.cx / pinhole.fx, (pinhole.width - pinhole.cx) / pinhole.fx
    top, bottom = -pinhole.cy / pinhole.fy, (pinhole.height - pinhole.cy) / pinhole.fy
    middle, tick = (left + right) / 2, top - 0.2 * (bottom - top)
    flat = [(0, 0), (left, top), (right, top), (right, bottom), (left, bottom)]
    flat += [(middle, top), (middle, tick)]
    points = depth * np.array([(x, y, 1.0) for x, y in flat])
    points[0] = 0.0
    map_from_cam = se3.inverse(cam_from_map)
    return np.asarray(points @ map_from_cam[:3, :3].T + map_from_cam[:3, 3])


def photo_plane(camera: Camera, depth: float) -> PhotoPlane:
    """Where the photo lies at this depth before its camera, without lens distortion: seen from
    the camera, it covers what it shows."""
    pinhole = camera.without_distortion()
    x = (pinhole.width / 2 - pinhole.cx) / pinhole.fx
    y = (pinhole.height / 2 - pinhole.cy) / pinhole.fy
    return PhotoPlane(
        depth * np.array([x, y, 1.0]),
        depth * pinhole.width / pinhole.fx,
        depth * pinhole.height / pinhole.fy,
    )


def viewpoint_of(shown: ShownCamera, window_aspect: float) -> Viewpoint:
    """At the camera's place, wide enough for its whole photo.

    Args:
        shown: the camera.
        window_aspect: width over height of the window.
    """
    pinhole = shown.camera.without_distortion()
    across = max(pinhole.cx, pinhole.width - pinhole.cx) / pinhole.fx
    down = max(pinhole.cy, pinhole.height - pinhole.cy) / pinhole.fy
    half = 1.02 * max(down, across / window_aspect)
    map_from_cam = se3.inverse(shown.cam_from_map)
    quaternion, position = se3.to_quaternion_translation(map_from_cam)
    return Viewpoint(position, quaternion, 2.0 * math.atan(half))


def between(begin: Viewpoint, end: Viewpoint, share: float) -> Viewpoint:
    """On the way from one to the other, at a share in [0, 1] of it: along a line, turning
    steadily about one axis."""
    first = se3.from_quaternion_translation(begin.quaternion, [0, 0, 0])
    last = se3.from_quaternion_translation(end.quaternion, [0, 0, 0])
    turned = first @ se3.exp(share * se3.log(se3.inverse(first) @ last))
    return Viewpoint(
        (1 - share) * begin.position + share * end.position,
        se3.to_quaternion_translation(turned)[0],
        (1 - share) * begin.vertical_angle + share * end.vertical_angle,
    )
