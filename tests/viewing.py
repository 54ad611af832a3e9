# SPDX-License-Identifier: Apache-2.0
"""The viewer's page as Chromium shows it, which renders in software here; and what arrives on it
while photos are localized or a camera is followed."""

from __future__ import annotations

import time
from typing import Any, Callable, ContextManager

import cv2
import numpy as np
from browser import PATIENCE, chromium
from numpy.typing import NDArray
from scenes import ROOM_POSE, room_camera

from gscpe.geometry import se3
from gscpe.poses.hloc import format_pose
from gscpe.sequences import Frame
from gscpe.tracking import TrackingResult
from gscpe.tracking.result import lost

SMALL = room_camera(80, 60)

OF_VISER = "THREE.BufferGeometry.computeBoundingSphere(): Computed radius is NaN"
"""viser 1.1 logs this of every splat, an empty page's too."""


def viewing_chromium() -> ContextManager[Any]:
    """A Chromium with a small window, that can draw."""
    return chromium(
        "--window-size=900,600", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"
    )


def wait_until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.1)


def picture(chromium: Any) -> NDArray[np.float64]:
    """What the browser shows left of the panel, (H, W, 3)."""
    stored = np.frombuffer(chromium.get_screenshot_as_png(), np.uint8)
    image = cv2.imdecode(stored, cv2.IMREAD_COLOR)
    assert image is not None
    return image[:, : image.shape[1] // 2, ::-1].astype(np.float64)


def near(image: NDArray[np.float64], colour: tuple[int, int, int]) -> int:
    """Pixels of about this colour."""
    return int(np.sum(np.abs(image - colour).max(axis=2) < 40))


def complaints(chromium: Any) -> list[str]:
    """Errors that the browser logged, but for those that are viser's own."""
    log = chromium.get_log("browser")
    severe = [entry["message"] for entry in log if entry["level"] == "SEVERE"]
    return [text for text in severe if OF_VISER not in text]


def detail(name: str, localized: bool, number: int = 0) -> dict[str, Any]:
    """A line of details, of a photo in the room."""
    pose = se3.exp([0.1 + 0.05 * number, -0.05, 0.3, 0.02, 0.1, 0.0]) @ ROOM_POSE
    return {
        "name": name,
        "camera": SMALL.colmap_text(),
        "status": "localized" if localized else "not localized",
        "reason": None if localized else "too few matches",
        "cam_from_world": format_pose(pose) if localized else None,
        "coarse": None,
        "aligned": None,
        "covariance": (1e-4 * np.eye(6)).tolist() if localized else None,
    }


def step(number: int) -> tuple[Frame, TrackingResult]:
    """A frame of a walk to the right; every fourth is lost."""
    image = np.full((60, 80, 3), 40 * (number % 6), np.uint8)
    frame = Frame(f"frame {number}", number / 10, image, SMALL, None, f"{number / 10}")
    if number % 4 == 3:
        return frame, lost("it is dark")
    pose = se3.exp([0.1 * number - 0.5, 0, 0.2, 0, 0, 0]) @ ROOM_POSE
    return frame, TrackingResult("tracking", None, pose, np.eye(6), 0, 0.9, 1.0)
