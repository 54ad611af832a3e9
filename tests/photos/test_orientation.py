# SPDX-License-Identifier: Apache-2.0
"""Photos that are stored turned: pixels, cameras and poses turn alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import distorted_projection, random_pose
from numpy.typing import NDArray
from PIL import Image, ImageOps

from gscpe import camera_from_exif, read_image
from gscpe.geometry import Camera
from gscpe.geometry.projection import project, transform_points
from gscpe.photos import read_image_of
from gscpe.photos.orientation import (
    QUARTER_TURNS,
    exif_orientation,
    inverse_orientation,
    swaps_sides,
    turned_camera,
    turned_from_cam,
    turned_image,
)

PINHOLE = Camera.pinhole(61, 47, fx=50.0, fy=52.0, cx=29.0, cy=25.0)
BENT = Camera(61, 47, 50.0, 52.0, 29.0, 25.0, (-0.2, 0.03, 0.02, -0.03, 0.01, 0.0, 0.0, 0.0))

ROUND = replace(BENT, distortion=(0.1, 0.03, 0.02, -0.03, 0.01, 0.0, 0.05, -0.08), fisheye=True)


def save(path: Path, orientation: object, seed: int = 0) -> NDArray[np.uint8]:
    """A lossless photo with this tag; its stored pixels."""
    pixels = np.random.default_rng(seed).integers(0, 256, (47, 61, 3), dtype=np.uint8)
    exif = Image.Exif()
    exif[0x0112] = orientation
    exif.get_ifd(0x8769)[0xA405] = 28
    Image.fromarray(pixels).save(path, exif=exif)
    return pixels


@pytest.mark.parametrize("orientation", range(1, 9))
def test_as_every_viewer_shows_it(orientation: int, tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    pixels = save(path, orientation)
    assert exif_orientation(path) == orientation
    with Image.open(path) as image:
        shown = np.asarray(ImageOps.exif_transpose(image))
    np.testing.assert_array_equal(read_image(path, upright=True), shown)
    np.testing.assert_array_equal(read_image(path), pixels)
    assert swaps_sides(orientation) == (shown.shape != pixels.shape)
    back = turned_image(turned_image(pixels, orientation), inverse_orientation(orientation))
    np.testing.assert_array_equal(back, pixels)


@pytest.mark.parametrize("tag", [0, 9, 700])
def test_orientations_that_are_none(tag: int, tmp_path: Path) -> None:
    save(tmp_path / "a.png", tag)
    assert exif_orientation(tmp_path / "a.png") == 1
    assert exif_orientation(tmp_path / "absent.png") == 1


@pytest.mark.parametrize("camera", [PINHOLE, BENT, ROUND], ids=["pinhole", "bent", "fisheye"])
@pytest.mark.parametrize("orientation", QUARTER_TURNS)
def test_pixels_cameras_and_poses_turn_alike(
    orientation: int, camera: Camera, rng: np.random.Generator
) -> None:
    """A point's pixel, marked in the stored image, is where the turned camera sees the point."""
    pose = random_pose(rng)
    in_cam = np.array([[0.2, -0.15, 1.0], [-0.3, 0.1, 1.2], [0.05, 0.3, 0.9]])
    turned = turned_camera(camera, orientation)
    seen_by = project if camera.is_pinhole else distorted_projection
    before = seen_by(camera, in_cam)
    rotation = turned_from_cam(orientation)
    world = transform_points(np.asarray(np.linalg.inv(pose)), in_cam)
    after = seen_by(turned, transform_points(rotation @ pose, world))
    image = np.zeros((camera.height, camera.width), np.uint8)
    for number, (u, v) in enumerate(before, start=1):
        image[int(v), int(u)] = number
    upright = turned_image(image, orientation)
    assert upright.shape == (turned.height, turned.width)
    for number, (u, v) in enumerate(after, start=1):
        assert upright[int(v), int(u)] == number
    # To the fraction of a pixel, too: turned about the middle of the picture.
    middle = np.array([camera.width, camera.height]) / 2
    middle_after = np.array([turned.width, turned.height]) / 2
    np.testing.assert_allclose(after, (before - middle) @ rotation[:2, :2].T + middle_after)
    assert turned_camera(turned, inverse_orientation(orientation)) == camera


@pytest.mark.parametrize("orientation", [2, 4, 5, 7])
def test_mirrored_cameras(orientation: int) -> None:
    """No pose belongs to a mirrored photo; its camera is that of the photo mirrored back."""
    turned = turned_camera(BENT, orientation)
    assert swaps_sides(orientation) == ((turned.width, turned.height) == (47, 61))
    once_more = turned_camera(turned, orientation)
    if orientation in (2, 4):
        assert once_more == BENT
    with pytest.raises(ValueError, match="mirrors"):
        turned_from_cam(orientation)


def test_the_camera_of_the_upright_photo(tmp_path: Path) -> None:
    save(tmp_path / "a.png", 6)
    stored = camera_from_exif(tmp_path / "a.png")
    upright = camera_from_exif(tmp_path / "a.png", upright=True)
    assert stored is not None
    assert upright is not None
    assert (stored.width, stored.height) == (61, 47)
    assert (upright.width, upright.height) == (47, 61)
    assert upright.fx == stored.fx


@pytest.mark.parametrize("orientation", [6, 8, 5, 7])
def test_the_camera_decides_which_way_up(orientation: int, tmp_path: Path) -> None:
    """As stored where it fits the stored pixels, as in COLMAP; upright where it fits those."""
    pixels = save(tmp_path / "a.png", orientation)
    np.testing.assert_array_equal(read_image_of(tmp_path / "a.png", PINHOLE), pixels)
    upright = turned_camera(PINHOLE, orientation)
    shown = read_image_of(tmp_path / "a.png", upright)
    np.testing.assert_array_equal(shown, turned_image(pixels, orientation))
