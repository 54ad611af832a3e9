# SPDX-License-Identifier: Apache-2.0
"""A camera that moves through the ray-cast room, and what it sees."""

from __future__ import annotations

import functools
import time

import numpy as np
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import Map, Tracker, TrackingResult, TrackingSettings, pose_difference
from gscpe.evaluation import normalized_error_squared
from gscpe.geometry import se3

CAMERA = room_camera(240, 180)
WAITS = TrackingSettings(wait=True)
TWIST = np.array([0.008, -0.003, 0.004, 0.002, 0.006, 0.003])
"""From frame to frame: about 1 cm and half a degree, 2 pixels."""


def pose(index: float) -> NDArray[np.float64]:
    """``cam_from_world`` of a frame; the first is beside the reference photo."""
    return se3.exp(index * TWIST) @ se3.exp([-0.05, 0.01, 0.0, 0.0, -0.03, 0.0]) @ ROOM_POSE


@functools.cache
def picture(index: float) -> NDArray[np.uint8]:
    """What the camera takes there, with the noise of a sensor."""
    rng = np.random.default_rng(int(1000 * index))
    rgb = 255.0 * room().shoot(CAMERA, pose(index)).rgb + rng.normal(0.0, 2.0, (180, 240, 3))
    return np.asarray(np.clip(np.rint(rgb), 0, 255), dtype=np.uint8)


@functools.cache
def the_map() -> Map:
    return room_map()


def black() -> NDArray[np.uint8]:
    return np.zeros((180, 240, 3), dtype=np.uint8)


@functools.cache
def foreign() -> NDArray[np.uint8]:
    """Of a room that is painted otherwise."""
    return room(7).shoot(CAMERA, ROOM_POSE).uint8


def right(
    result: TrackingResult,
    true_pose: NDArray[np.float64],
    metres: float = 0.01,
    degrees: float = 0.2,
) -> None:
    """A pixel is a centimetre here; the map is made of one photo, its depth exact."""
    assert result.cam_from_world is not None, result.reason
    assert result.covariance is not None
    error = pose_difference(result.cam_from_world, true_pose)
    assert error.distance < metres
    assert error.degrees < degrees
    # Five standard deviations, in each of six directions together.
    assert normalized_error_squared(result.cam_from_world, result.covariance, true_pose) < 6 * 25


def until_found(tracker: Tracker, index: float, seconds: float = 60.0) -> TrackingResult:
    """Shows a camera that stands still until its pose is known."""
    end = time.monotonic() + seconds
    while True:
        result = tracker.track(picture(index), CAMERA)
        if result.status != "lost" or time.monotonic() > end:
            return result
        time.sleep(0.02)
