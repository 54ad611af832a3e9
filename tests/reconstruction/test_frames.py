# SPDX-License-Identifier: Apache-2.0
"""Frames of a video: sharp ones, evenly along the way."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import wall

from gscpe.errors import ReconstructionError
from gscpe.geometry import Camera
from gscpe.reconstruction import ReconstructionSettings
from gscpe.reconstruction.frames import WatchedFrame, choose_frames, read_frames, watch
from gscpe.reconstruction.photos import prepare_photos
from gscpe.reconstruction.sources import find_source

WIDTH, HEIGHT = 160, 120


@pytest.fixture(scope="module")
def panorama() -> NDArray[np.uint8]:
    camera = Camera.pinhole(800, HEIGHT, fx=200, fy=200, cx=400, cy=60)
    return wall().shoot(camera, np.eye(4)).uint8


def write_video(path: Path, frames: list[NDArray[np.uint8]]) -> Path:
    fourcc = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(path), fourcc, 12.0, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for frame in frames:
        writer.write(np.ascontiguousarray(frame[:, :, ::-1]))
    writer.release()
    return path


def test_sharp_frames_are_taken_evenly_along_the_way(
    tmp_path: Path, panorama: NDArray[np.uint8]
) -> None:
    """The picture moves by 8 pixels a frame, rests for ten, and moves on; every other is
    blurred."""
    shifts = [*range(0, 240, 8), *([240] * 10), *range(248, 488, 8)]
    frames = []
    for number, shift in enumerate(shifts):
        frame = panorama[:, shift : shift + WIDTH]
        if number % 2:
            frame = np.asarray(cv2.GaussianBlur(frame, (0, 0), 4), dtype=np.uint8)
        frames.append(frame)
    path = write_video(tmp_path / "walk.avi", frames)

    watched = watch(path)
    assert watched[-1].way == pytest.approx(480 / WIDTH, rel=0.1)
    chosen = choose_frames(watched, 12)
    numbers = [frame.number for frame in chosen]
    assert len(numbers) in (11, 12)
    assert not any(number % 2 for number in numbers), "blurred frames are left out"
    steps = np.diff([shifts[number] for number in numbers])
    assert steps.min() >= 5, "no two of the rest"
    assert steps.max() <= 80

    photos, unusable = prepare_photos(
        find_source([path]), tmp_path / "images", ReconstructionSettings(frames=12)
    )
    assert not unusable
    assert [photo.name for photo in photos] == [f"walk/{number:06d}.jpg" for number in numbers]
    assert {photo.video for photo in photos} == {"walk"}
    for number, image in read_frames(path, numbers[:2]):
        error = np.abs(image.astype(float) - frames[number].astype(float)).mean()
        assert error < 8, "colours are RGB, and frames those that were asked for"


def test_frames_are_not_taken_closer_than_they_differ() -> None:
    watched = [WatchedFrame(i, 0.001 * i, 0.3) for i in range(200)]
    assert len(choose_frames(watched, 100)) in (5, 6)
    assert choose_frames([], 5) == []


def test_a_video_that_hardly_moves(tmp_path: Path, panorama: NDArray[np.uint8]) -> None:
    path = write_video(tmp_path / "still.avi", [panorama[:, :WIDTH]] * 20)
    with pytest.raises(ReconstructionError, match="hardly moves"):
        watch(path)


def test_a_video_that_cannot_be_decoded(tmp_path: Path) -> None:
    path = tmp_path / "clip.mp4"
    path.write_bytes(np.random.default_rng(0).bytes(5000))
    with pytest.raises(ReconstructionError, match=r"clip\.mp4 cannot be opened"):
        watch(path)
    with pytest.raises(ReconstructionError, match="neither a photo nor a video"):
        find_source([Path(__file__)])
