# SPDX-License-Identifier: Apache-2.0
"""Cameras held upside down, or on their side: found, and what is found is of the photo as it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import Localizer
from gscpe.arrays import BoolArray, UInt8Array
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.geometry.projection import project, transform_points
from gscpe.localization.attempt import Attempt
from gscpe.localization.clock import Clock
from gscpe.localization.prepared import PreparedPhoto
from gscpe.localization.starts import Start
from gscpe.localization.turns import pixels_turned_back, turned_back, turned_photo
from gscpe.matching import Matches, SiftMatcher
from gscpe.matching.protocol import no_matches
from gscpe.photos import Photo
from gscpe.photos.orientation import (
    inverse_orientation,
    turned_camera,
    turned_from_cam,
    turned_image,
)

CAMERA = room_camera(240, 180)
TRUTH = np.asarray(se3.exp([0.06, -0.03, 0.05, 0.02, -0.03, 0.01]) @ ROOM_POSE)


class Upright:
    """As learned features are: matches only what is turned alike. Its first image is the photo;
    ``up`` is where the photo's floor is."""

    def __init__(self, floor: UInt8Array) -> None:
        self._sift = SiftMatcher()
        self._floor = floor

    def prepare(self, rgb: UInt8Array, valid: BoolArray | None) -> Any:
        return rgb, self._sift.prepare(rgb, valid)

    def match(self, photo: Any, render: Any) -> Matches:
        turned_alike = photo[0].shape == self._floor.shape and np.array_equal(photo[0], self._floor)
        return self._sift.match(photo[1], render[1]) if turned_alike else no_matches()


@pytest.mark.parametrize("orientation", [6, 8, 3])
def test_any_quarter_turn_is_found(orientation: int) -> None:
    upright = room().shoot(CAMERA, TRUTH, samples=2).uint8
    back = inverse_orientation(orientation)
    stored, camera = turned_image(upright, back), turned_camera(CAMERA, back)
    true_pose = turned_from_cam(back) @ TRUTH
    with Localizer(room_map(), matcher=Upright(upright)) as localizer:
        result = localizer.localize(stored, camera)
        view = localizer.render(camera, result.cam_from_world) if result.localized else None  # type: ignore[arg-type]
        estimated = localizer.estimate_camera(stored)
    assert (estimated.width, estimated.height) == (camera.width, camera.height)
    assert abs(np.log(estimated.fx / camera.fx)) < 4.0 * estimated.focal_sigma < 0.12
    assert result.localized, result.reason
    assert result.best is not None and result.best.orientation == orientation
    assert len(result.attempts) >= 2 and result.attempts[0].orientation == 1
    assert result.coarse is not None and result.aligned is not None and view is not None
    for pose in (
        result.cam_from_world,
        result.coarse.cam_from_world,
        result.aligned.cam_from_world,
    ):
        assert pose is not None
        error = pose_difference(pose, true_pose)
        assert error.distance < 0.01 and error.degrees < 0.3
    # The errors are as large as the covariance of the stored photo's pose says, axis by axis.
    assert result.cam_from_world is not None and result.covariance is not None
    xi = se3.log(true_pose @ se3.inverse(result.cam_from_world))
    assert np.all(np.abs(xi) < 5.0 * np.sqrt(np.diag(result.covariance)))
    # A principal point further right looks like a turn to the left; further down, like one up.
    by_camera = result.aligned.by_camera
    assert by_camera is not None and by_camera[4, 2] < 0 < by_camera[3, 3]
    height, width = stored.shape[:2]
    assert view.rgb.shape == stored.shape
    pixels = result.coarse.inlier_pixels
    assert np.all((pixels >= 0) & (pixels <= [width, height]))


def test_what_no_turn_helps_is_not_localized() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (180, 240, 3), dtype=np.uint8)
    nothing = np.zeros((1, 1, 3), np.uint8)
    with Localizer(room_map(), matcher=Upright(nothing)) as localizer:
        result = localizer.localize(noise, CAMERA)
    assert not result.localized
    assert {attempt.orientation for attempt in result.attempts} <= {1, 3, 6, 8}


@pytest.mark.parametrize("orientation", [6, 8, 3])
def test_poses_covariances_and_pixels_turn_together(
    orientation: int, rng: np.random.Generator
) -> None:
    """A point that a turned camera sees in a pixel is seen by the stored one where that goes."""
    camera = Camera.pinhole(64, 48, fx=50, fy=45, cx=30.5, cy=25.0)
    photo = Photo(np.zeros((48, 64, 3), np.uint8), camera)
    turned = PreparedPhoto(turned_photo(photo, orientation), SiftMatcher(), Clock(), orientation)
    cam_from_world = se3.exp(rng.normal(scale=0.3, size=6))
    turned_from_world = turned_from_cam(orientation) @ cam_from_world
    in_cam = np.array([[0.2, -0.15, 1.0], [-0.3, 0.1, 1.2], [0.05, 0.3, 0.9]])
    world = transform_points(se3.inverse(cam_from_world), in_cam)
    seen = project(turned.photo.camera, transform_points(turned_from_world, world))
    np.testing.assert_allclose(pixels_turned_back(seen, turned), project(camera, in_cam), atol=1e-9)
    attempt = Attempt(Start("reference", turned_from_world, "a"), None, None, "no")
    back = turned_back(attempt, turned)
    np.testing.assert_allclose(back.start.cam_from_world, cam_from_world, atol=1e-12)
    assert back.orientation == orientation
    assert turned.photo.rgb.shape[:2] == (turned.photo.camera.height, turned.photo.camera.width)


def mask(shape: tuple[int, int]) -> NDArray[np.bool_]:
    valid = np.ones(shape, dtype=bool)
    valid[0] = False
    return valid


def test_masks_turn_with_the_photo() -> None:
    photo = Photo(
        np.zeros((4, 6, 3), np.uint8), Camera.pinhole(6, 4, fx=5, fy=5, cx=3, cy=2), mask((4, 6))
    )
    on_its_side = turned_photo(photo, 6)  # clockwise: the top row becomes the right column
    assert on_its_side.valid is not None
    assert on_its_side.valid.shape == (6, 4)
    assert not on_its_side.valid[:, -1].any() and on_its_side.valid[:, :-1].all()
