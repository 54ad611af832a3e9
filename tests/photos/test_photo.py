# SPDX-License-Identifier: Apache-2.0
"""Photos: decoded as stored, undistorted to a fraction of a pixel, refused with a reason."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import simple_camera
from numpy.typing import NDArray

from gscpe.errors import CameraError, OutputError, PhotoError
from gscpe.photos import read_image, to_photo
from gscpe.photos.image_file import write_image


@pytest.fixture
def picture(rng: np.random.Generator) -> NDArray[np.uint8]:
    return rng.integers(0, 256, (47, 61, 3), dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tiff", ".PNG"])
def test_lossless_round_trip(suffix: str, tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    path = tmp_path / "new folder" / f"büro{suffix}"
    write_image(path, picture)
    again = read_image(path)
    np.testing.assert_array_equal(again, picture)
    assert again.flags.c_contiguous
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_jpeg_keeps_the_order_of_the_colours(tmp_path: Path) -> None:
    red = np.zeros((32, 32, 3), np.uint8)
    red[:, :, 0] = 250
    write_image(tmp_path / "a.jpg", red)
    np.testing.assert_allclose(
        read_image(tmp_path / "a.jpg").mean(axis=(0, 1)), [250, 0, 0], atol=3
    )


def test_floats_are_rounded_and_clipped(tmp_path: Path) -> None:
    values = np.array([[-1.0, 0.0, 0.4999 / 255, 0.5001 / 255, 127.4 / 255, 1.0, 7.0]], np.float32)
    write_image(tmp_path / "a.png", values)
    grey = [0, 0, 0, 1, 127, 255, 255]
    np.testing.assert_array_equal(read_image(tmp_path / "a.png")[0], np.stack([grey] * 3, axis=1))


def test_other_pixel_formats_become_rgb(tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    path = str(tmp_path / "a.png")
    cv2.imwrite(path, picture[:, :, 0])
    np.testing.assert_array_equal(read_image(path), np.repeat(picture[:, :, :1], 3, axis=2))
    cv2.imwrite(path, np.dstack([picture, np.full((47, 61), 200, np.uint8)]))
    np.testing.assert_array_equal(read_image(path), picture[:, :, ::-1])
    cv2.imwrite(path, picture.astype(np.uint16) * 257)
    np.testing.assert_array_equal(read_image(path), picture[:, :, ::-1])


def test_exif_rotation_is_ignored(tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    path = tmp_path / "a.jpg"
    write_image(path, picture)
    plain = read_image(path)
    quarter_turn = struct.pack("<2sHIHHHIII", b"II", 42, 8, 1, 0x0112, 3, 1, 6, 0)
    exif = b"Exif\0\0" + quarter_turn
    data = path.read_bytes()
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:])
    turned = cv2.imread(str(path))
    assert turned is not None
    assert turned.shape[:2] == (61, 47)  # the tag does say something
    np.testing.assert_array_equal(read_image(path), plain)


def test_missing_and_unreadable_photos(tmp_path: Path) -> None:
    for path in (tmp_path / "absent.png", tmp_path, tmp_path / "absent" / "a.png"):
        with pytest.raises(PhotoError, match="cannot be read") as caught:
            read_image(path)
        assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "content", [b"", b"\0", b"This is not a photo.\n", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"]
)
def test_files_that_are_no_images(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    path.write_bytes(content)
    with pytest.raises(PhotoError, match=r"is not an image|is empty|is cut off") as caught:
        read_image(path)
    assert str(path) in str(caught.value)


def test_truncated_png(tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    path = tmp_path / "photo.png"
    write_image(path, picture)
    data = path.read_bytes()
    for length in (20, 40, len(data) // 2):
        path.write_bytes(data[:length])
        with pytest.raises(PhotoError, match="is not an image"):
            read_image(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_damaged_images_never_raise_anything_else(
    suffix: str, tmp_path: Path, picture: NDArray[np.uint8]
) -> None:
    path = tmp_path / f"photo{suffix}"
    write_image(path, picture)
    data = path.read_bytes()
    rng = np.random.default_rng(4)
    for offset in rng.integers(0, min(len(data), 400), 100):
        damaged = bytearray(data)
        damaged[offset] ^= rng.integers(1, 256)
        path.write_bytes(damaged)
        try:
            pixels = read_image(path)
        except PhotoError as error:
            assert str(path) in str(error)
        else:
            assert pixels.dtype == np.uint8
            assert pixels.ndim == 3


def test_outputs_that_cannot_be_written(tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    (tmp_path / "file").write_text("hello")
    (tmp_path / "folder.png").mkdir()
    for path in (tmp_path / "file" / "a.png", tmp_path / "folder.png"):
        with pytest.raises(OutputError, match="cannot be written") as caught:
            write_image(path, picture)
        assert str(path) in str(caught.value)


@pytest.mark.parametrize("name", ["a", "a.xyz", "a.txt", ".png"])
def test_endings_that_name_no_format(name: str, tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    with pytest.raises(OutputError, match=r"use \.png or \.jpg") as caught:
        write_image(tmp_path / name, picture)
    assert str(tmp_path / name) in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_pinhole_photo_is_taken_as_it_is(picture: NDArray[np.uint8]) -> None:
    camera = simple_camera(61, 47)
    photo = to_photo(picture, camera)
    np.testing.assert_array_equal(photo.rgb, picture)
    assert photo.camera == camera
    assert photo.valid is None
    assert to_photo(picture[:, ::-1], camera).rgb.flags.c_contiguous
    grey = to_photo(picture[:, :, 0], camera)
    np.testing.assert_array_equal(grey.rgb, np.repeat(picture[:, :, :1], 3, axis=2))


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((47, 61, 3), np.float32),
        np.zeros((47, 61, 3), np.uint16),
        np.zeros((47, 61, 5), np.uint8),
        np.zeros((47, 61, 2), np.uint8),
        np.zeros((1, 47, 61, 3), np.uint8),
        np.zeros(61, np.uint8),
        None,
    ],
)
def test_arrays_that_are_no_photos(image: NDArray[np.uint8]) -> None:
    with pytest.raises(PhotoError, match=r"must be \(height, width, 3\) uint8 RGB, not"):
        to_photo(image, simple_camera(61, 47))


def test_a_camera_of_another_size(picture: NDArray[np.uint8]) -> None:
    for camera in (simple_camera(47, 61), simple_camera(122, 94)):
        with pytest.raises(CameraError, match="the photo is 61x47, but its camera is"):
            to_photo(picture, camera)


def test_a_real_photo(kitchen: Path) -> None:
    photos = sorted((kitchen / "references").glob("*.jpg"))
    pixels = read_image(photos[0])
    assert pixels.shape == (480, 640, 3)
    assert 20 < pixels.mean() < 235
