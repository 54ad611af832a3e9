# SPDX-License-Identifier: Apache-2.0
"""``gscpe track`` where something is wrong with the frames: it says so, and finds back."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe.cli.main import main
from gscpe.geometry import se3
from gscpe.photos import write_image
from gscpe.poses.hloc import parse_pose
from gscpe.scene import save_map

CAMERA = room_camera(240, 180)
STEP = np.array([0.005, -0.002, 0.003, 0.002, 0.003, -0.002])
BACK = np.array([0.0, 0.0, 0.0, 0.02, -0.3, 0.05])
"""A turn to where the map shows less than before."""

Image = NDArray[np.uint8]


def pose_at(number: int) -> NDArray[np.float64]:
    """To and fro, near the map's only photo."""
    return se3.exp((4 - abs(number % 16 - 8)) * STEP) @ ROOM_POSE


@functools.cache
def photo(number: int, seed: int = 0, turn: float = 0.0) -> Image:
    return room(seed).shoot(CAMERA, se3.exp(turn * BACK) @ pose_at(number)).uint8


def dark(number: int) -> Image:
    return np.asarray(photo(number) // 40, dtype=np.uint8)


def blurred(number: int) -> Image:
    """By a fast turn: an eighth of the picture's width."""
    kernel = np.full((1, 31), 1 / 31)
    return np.asarray(cv2.filter2D(photo(number), -1, kernel), dtype=np.uint8)


def hand(number: int) -> Image:
    """Skin over three quarters of the picture."""
    image = photo(number).copy()
    image[:, 60:] = (190, 140, 120)
    return image


def passer_by(number: int) -> Image:
    """Somebody in a coat with a pattern walks through."""
    image, other = photo(number).copy(), photo(number, seed=7)
    left = 20 + 30 * (number % 6)
    image[20:, left : left + 60] = other[20:, left : left + 60]
    return image


def foreign(number: int) -> Image:
    """Another room."""
    return photo(number, seed=3)


def noise(number: int) -> Image:
    rng = np.random.default_rng(number)
    return rng.integers(0, 256, (180, 240, 3)).astype(np.uint8)


def jumped(number: int) -> Image:
    """The camera is elsewhere at once, and looks the other way a bit."""
    return photo(number, turn=0.4)


TROUBLE: dict[str, Any] = {
    made.__name__: made for made in (dark, blurred, hand, passer_by, foreign, noise, jumped)
}
HOPELESS = {"dark", "foreign", "noise"}
FROM, TO, END = 4, 9, 13


@pytest.fixture(scope="module")
def map_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("honesty") / "room.gsmap"
    save_map(room_map(), folder)
    return folder


@pytest.mark.parametrize("name", TROUBLE)
def test_wrong_poses_are_not_called_right(name: str, map_folder: Path, tmp_path: Path) -> None:
    """Five good frames, five with trouble, four good ones: no pose is more than five of its own
    standard deviations off, of what shows no room of ours there is none, and the camera is found
    again."""
    truth = {}
    for number in range(END + 1):
        troubled = FROM < number <= TO
        image = TROUBLE[name](number) if troubled else photo(number)
        file = f"{number:06d}.png"
        write_image(tmp_path / "film" / file, image)
        turn = 0.4 if troubled and name == "jumped" else 0.0
        truth[file] = se3.exp(turn * BACK) @ pose_at(number)
    words = ["track", str(map_folder), str(tmp_path / "film"), "--output", str(tmp_path / "t.tum")]
    words += ["--camera", CAMERA.colmap_text(), "--rate", "30", "--matcher", "sift"]
    assert main(words) == 0
    lines = (tmp_path / "t.details.jsonl").read_text().splitlines()
    details = [json.loads(line) for line in lines]
    assert [detail["name"] for detail in details] == list(truth)
    for detail in details:
        if detail["status"] == "lost":
            assert detail["reason"] and detail["cam_from_world"] is None
            continue
        assert detail["status"] in ("tracking", "relocalized")
        off = se3.log(parse_pose(detail["cam_from_world"]) @ se3.inverse(truth[detail["name"]]))
        covariance = np.array(detail["covariance"])
        deviations = np.abs(off) / np.sqrt(np.diag(covariance))
        assert deviations.max() < 5.0, (detail["name"], deviations)
    statuses = [detail["status"] for detail in details]
    assert statuses[: FROM + 1] == ["relocalized", *["tracking"] * FROM]
    if name in HOPELESS:
        assert set(statuses[FROM + 1 : TO + 1]) == {"lost"}
    assert "lost" not in statuses[-2:]
