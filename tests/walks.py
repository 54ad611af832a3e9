# SPDX-License-Identifier: Apache-2.0
"""Photos of a walk through the ray-cast room, as a phone would leave them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scenes import room

from gscpe.geometry import Camera, se3

EQUIVALENT = 32  # millimetres, of 35 mm film
_FOCAL = EQUIVALENT * np.hypot(240, 180) / np.hypot(36, 24)
WALK_CAMERA = Camera.pinhole(240, 180, fx=_FOCAL, fy=_FOCAL, cx=120, cy=90)


def walk_poses(count: int) -> list[NDArray[np.float64]]:
    """Half a metre to either side, up and down a little, looking ahead."""
    poses = []
    for i in range(count):
        side = 2.0 * i / (count - 1) - 1.0
        turn = se3.exp([0, 0, 0, 0.05 * np.sin(3.0 * i), -0.12 * side, 0.02 * np.cos(5.0 * i)])
        step = se3.exp([-0.5 * side, 0.12 * np.cos(2.0 * i), 0.15 * np.sin(1.7 * i), 0, 0, 0])
        poses.append(turn @ step)
    return poses


def write_jpeg(
    path: Path,
    rgb: NDArray[np.uint8],
    equivalent: int | None = EQUIVALENT,
    orientation: int = 1,
    gps: tuple[float, float, float] | None = None,
) -> None:
    """A photo with EXIF; it is stored so that ``orientation`` turns it upright."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    if equivalent is not None:
        exif.get_ifd(0x8769)[0xA405] = equivalent
    if gps is not None:
        block = exif.get_ifd(0x8825)
        for tag, value, sides in ((1, gps[0], "NS"), (3, gps[1], "EW")):
            degrees = int(abs(value))
            minutes = int(60 * (abs(value) - degrees))
            seconds = 3600 * (abs(value) - degrees) - 60 * minutes
            block[tag] = sides[value < 0]
            block[tag + 1] = (degrees, minutes, seconds)
        block[5], block[6] = bytes([gps[2] < 0]), abs(gps[2])
    stored = rgb if orientation == 1 else np.rot90(rgb, 1)  # 6: a quarter turn clockwise
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.ascontiguousarray(stored)).save(path, quality=95, exif=exif)


def write_walk(folder: Path, count: int) -> dict[str, NDArray[np.float64]]:
    """``cam_from_world`` by name; every fourth photo is stored turned."""
    poses = {f"IMG_{i:04d}.jpg": pose for i, pose in enumerate(walk_poses(count))}
    for i, (name, pose) in enumerate(poses.items()):
        rgb = room().shoot(WALK_CAMERA, pose, samples=2).uint8
        write_jpeg(folder / name, rgb, orientation=6 if i % 4 == 3 else 1)
    return poses
