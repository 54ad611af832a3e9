# SPDX-License-Identifier: Apache-2.0
"""Frames that are photos, and their times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gscpe.errors import CameraError, QueryListError, SequenceError, SettingsError
from gscpe.geometry import Camera
from gscpe.photos import write_image
from gscpe.sequences import open_frames
from gscpe.sequences.times import in_natural_order, times_of_names

CAMERA = Camera.pinhole(32, 24, fx=30, fy=30, cx=16, cy=12)


def write_photos(folder: Path, names: list[str]) -> Path:
    """Photo i is of the brightness 10 i."""
    for number, name in enumerate(names):
        write_image(folder / name, np.full((24, 32, 3), 10 * number, dtype=np.uint8))
    return folder


def brightness(frames: object) -> list[int]:
    return [int(f.image[0, 0, 0]) if f.image is not None else -1 for f in frames]  # type: ignore[attr-defined]


def test_a_folder_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    write_photos(tmp_path, ["frame-10.color.png", "frame-9.color.png", "frame-100.color.png"])
    frames = open_frames(tmp_path, CAMERA)
    assert frames.length == 3
    read = list(frames)
    assert brightness(read) == [10, 0, 20]
    assert [(frame.time, frame.stamp) for frame in read] == [(None, "0"), (None, "1"), (None, "2")]
    assert [frame.time for frame in open_frames(tmp_path, CAMERA, rate=10.0)] == [0.0, 0.1, 0.2]
    assert in_natural_order(["b2", "b10", "b1", "a11"]) == ["a11", "b1", "b2", "b10"]


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["1311868164.363181.png", "rgb/1311868164.4.png"], [1311868164.363181, 1311868164.4]),
        (["1403636579763555584.png", "1403636580.png"], None),
        (["1403636579763555584.png"], [1403636579.7635555]),
        (["1403636579763.png"], [1403636579.763]),
        (["1403636579.png", "1403636580.png"], [1403636579.0, 1403636580.0]),
        (["000040.png", "000041.png"], None),
        (["a.png"], None),
    ],
)
def test_names_that_are_times(names: list[str], times: list[float] | None) -> None:
    assert times_of_names(names) == times


def test_a_folder_named_by_times(tmp_path: Path) -> None:
    write_photos(tmp_path, ["10.5.png", "9.25.png"])
    read = list(open_frames(tmp_path, CAMERA))
    assert [frame.time for frame in read] == [9.25, 10.5]
    assert [frame.stamp for frame in read] == ["9.25", "10.5"]


def test_numbers_of_frames_are_stamps_and_not_seconds(tmp_path: Path) -> None:
    write_photos(tmp_path, ["000040.png", "000041.png"])
    read = list(open_frames(tmp_path, CAMERA))
    assert [(frame.time, frame.stamp) for frame in read] == [(None, "000040"), (None, "000041")]


def test_a_list_with_cameras(tmp_path: Path) -> None:
    """In its own order, which nothing contradicts."""
    write_photos(tmp_path / "photos", ["b.png", "my photo.png"])
    listed = tmp_path / "list.txt"
    text = CAMERA.colmap_text()
    listed.write_text(f"my photo.png {text}\nb.png {text}\n")
    read = list(open_frames(listed, images=tmp_path / "photos"))
    assert [frame.name for frame in read] == ["my photo.png", "b.png"]
    assert brightness(read) == [10, 0]
    assert {frame.camera for frame in read} == {CAMERA}
    listed.write_text("b.png\n")
    with pytest.raises(QueryListError, match="--camera"):
        open_frames(listed, images=tmp_path / "photos")
    with pytest.raises(SequenceError, match=r"none of the 1 photos is in .*--images"):
        open_frames(listed, CAMERA)
    with pytest.raises(SequenceError, match="is not a folder"):
        open_frames(listed, CAMERA, images=tmp_path / "nowhere")


def test_times_in_a_file(tmp_path: Path) -> None:
    write_photos(tmp_path / "rgb", ["b.png", "a.png"])
    times = tmp_path / "times.txt"
    for text in ("# TUM\n7.5 rgb/b.png\n8 rgb/a.png\n", "a.png, 8\nb.png, 7.5\n"):
        times.write_text(text)
        read = list(open_frames(tmp_path / "rgb", CAMERA, times=times))
        assert [(frame.name, frame.time) for frame in read] == [("b.png", 7.5), ("a.png", 8.0)]
    times.write_text("1\n2\n")
    read = list(open_frames(tmp_path / "rgb", CAMERA, times=times))
    assert [(frame.name, frame.time) for frame in read] == [("a.png", 1.0), ("b.png", 2.0)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1\n", "1 times for 2 photos"),
        ("1\n2 b.png\n", "give one form"),
        ("1 a.png\n", "no time for b.png"),
        ("1 x/a.png\n2 y/a.png\n3 b.png\n", "several times for a.png"),
        ("a.png soon\n", "line 1: expected 'name seconds'"),
        ("nan\n2\n", "not finite"),
    ],
)
def test_times_that_are_none(text: str, words: str, tmp_path: Path) -> None:
    write_photos(tmp_path / "rgb", ["a.png", "b.png"])
    (tmp_path / "times.txt").write_text(text)
    with pytest.raises(SequenceError, match=words):
        open_frames(tmp_path / "rgb", CAMERA, times=tmp_path / "times.txt")


def test_a_list_whose_times_run_backwards(tmp_path: Path) -> None:
    write_photos(tmp_path, ["2.0.png", "1.0.png"])
    (tmp_path / "list.txt").write_text("2.0.png\n1.0.png\n")
    with pytest.raises(SequenceError, match=r"1 s before that of 2\.0\.png"):
        list(open_frames(tmp_path / "list.txt", CAMERA))


def test_photos_that_cannot_be_read(tmp_path: Path) -> None:
    """They do not stop the others."""
    write_photos(tmp_path, ["a.png", "b.png", "c.png", "d.png"])
    (tmp_path / "b.png").write_bytes(b"no photo")
    write_image(tmp_path / "c.png", np.zeros((24, 30, 3), np.uint8))
    read = list(open_frames(tmp_path, CAMERA))
    assert brightness(read) == [0, -1, -1, 30]
    assert "not an image that can be decoded" in str(read[1].trouble)
    assert "30x24, but its camera is 32x24" in str(read[2].trouble)


def test_what_does_not_go_together(tmp_path: Path) -> None:
    write_photos(tmp_path / "photos", ["a.png"])
    with pytest.raises(SettingsError, match="--topic does not go with a folder"):
        open_frames(tmp_path / "photos", CAMERA, topic="/image")
    with pytest.raises(SettingsError, match="--images does not go with a folder"):
        open_frames(tmp_path / "photos", CAMERA, images=tmp_path)
    with pytest.raises(SettingsError, match="--times does not go with a device"):
        open_frames("device:0", CAMERA, times="times.txt")
    with pytest.raises(SettingsError, match="--rate does not go with a device"):
        open_frames("device:0", CAMERA, rate=30.0)
    with pytest.raises(SettingsError, match="rate must be positive"):
        open_frames(tmp_path / "photos", CAMERA, rate=0.0)
    with pytest.raises(CameraError, match="is not known: give it"):
        open_frames(tmp_path / "photos")


def test_what_is_no_sequence(tmp_path: Path) -> None:
    write_photos(tmp_path / "photos", ["a.png"])
    (tmp_path / "empty").mkdir()
    (tmp_path / "splat.ply").write_bytes(b"ply\0\1\2")
    (tmp_path / "empty.txt").write_text("")
    with pytest.raises(SequenceError, match=r"holds no photos .* nor is it a ROS bag"):
        open_frames(tmp_path / "empty", CAMERA)
    with pytest.raises(SequenceError, match="is a single photo"):
        open_frames(tmp_path / "photos" / "a.png", CAMERA)
    with pytest.raises(SequenceError, match="no sequence that gscpe can read; expected a video"):
        open_frames(tmp_path / "splat.ply", CAMERA)
    with pytest.raises(SequenceError, match="names no device"):
        open_frames("device:", CAMERA)
    with pytest.raises(QueryListError, match="is empty"):
        open_frames(tmp_path / "empty.txt", CAMERA)
