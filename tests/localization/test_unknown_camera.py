# SPDX-License-Identifier: Apache-2.0
"""Photos of unknown cameras, and of cameras that are known so well: how sure the poses are."""

from __future__ import annotations

from dataclasses import replace
from typing import Iterator

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_map, wall

from gscpe import Localizer, References
from gscpe.coarse import IntrinsicsSettings
from gscpe.errors import CameraError, MapError, PhotoError
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.localization.unknown_camera import ordinary_camera

PHOTO_CAMERA = Camera.pinhole(240, 180, fx=230.0, fy=230.0, cx=120.0, cy=90.0)
BESIDE = np.asarray(se3.exp([0.08, -0.05, 0.06, 0.03, -0.03, 0.04]) @ ROOM_POSE)


@pytest.fixture(scope="module")
def localizer() -> Iterator[Localizer]:
    with Localizer(room_map()) as localizer:
        yield localizer


@pytest.mark.parametrize("guess", [None, 300.0])
def test_the_camera_of_a_photo(guess: float | None, localizer: Localizer) -> None:
    """The focal length within 1%, from an ordinary lens (216 pixels) or a guess 30% off;
    with it the photo is localized."""
    image = room().shoot(PHOTO_CAMERA, BESIDE, samples=2).uint8
    first = None
    if guess is not None:
        first = Camera.pinhole(240, 180, fx=guess, fy=guess, cx=120.0, cy=90.0)
    camera = localizer.estimate_camera(image, first)
    assert (camera.width, camera.height) == (240, 180)
    assert np.hypot(camera.cx - 120.0, camera.cy - 90.0) < 4.0
    assert camera.fx == pytest.approx(230.0, rel=0.01)
    assert camera.fy == pytest.approx(230.0, rel=0.01)
    result = localizer.localize(image, camera)
    assert result.cam_from_world is not None
    error = pose_difference(result.cam_from_world, BESIDE)
    assert error.distance < 0.03
    assert error.degrees < 0.2


def test_photos_that_do_not_tell(localizer: Localizer) -> None:
    blank = np.full((180, 240, 3), 128, np.uint8)
    elsewhere = wall().shoot(PHOTO_CAMERA, np.eye(4)).uint8
    for image in (blank, elsewhere):
        with pytest.raises(CameraError, match=r"cannot be estimated: "):
            localizer.estimate_camera(image)
    with pytest.raises(PhotoError, match="uint8 RGB, not float64"):
        localizer.estimate_camera(blank / 255.0)  # type: ignore[arg-type]
    with pytest.raises(CameraError, match="the photo is 240x180, but its camera is 640x480"):
        localizer.estimate_camera(
            blank, Camera.pinhole(640, 480, fx=525.0, fy=525.0, cx=320.0, cy=240.0)
        )


def test_a_map_without_references() -> None:
    known = room_map()
    alone = replace(
        known,
        references=References(names=(), cam_from_world=np.zeros((0, 4, 4)), cameras=()),
        descriptors=replace(known.descriptors, descriptors=known.descriptors.descriptors[:0]),
    )
    with Localizer(alone) as localizer, pytest.raises(MapError, match="without reference photos"):
        localizer.estimate_camera(np.zeros((180, 240, 3), np.uint8))


def test_an_ordinary_lens() -> None:
    """About 58 degrees over the longer side, whichever that is."""
    for shape in ((480, 640, 3), (640, 480, 3)):
        camera = ordinary_camera(np.zeros(shape, np.uint8), IntrinsicsSettings())
        assert (camera.height, camera.width) == shape[:2]
        assert camera.fx == camera.fy == pytest.approx(576.0)
        assert (camera.cx, camera.cy) == (shape[1] / 2, shape[0] / 2)


@pytest.mark.parametrize("factor", [0.85, 1.0, 1.01, 1.2])
def test_a_photo_is_never_far_off_with_confidence(factor: float, localizer: Localizer) -> None:
    """A wrong camera is refused, with that reason, or its error is in the covariance."""
    image = room().shoot(PHOTO_CAMERA, BESIDE, samples=2).uint8
    fx, fy = factor * PHOTO_CAMERA.fx, factor * PHOTO_CAMERA.fy
    result = localizer.localize(image, replace(PHOTO_CAMERA, fx=fx, fy=fy))
    if abs(factor - 1.0) > 0.1:
        assert not result.localized
        assert result.reason is not None and "camera's focal length" in result.reason
        return
    assert result.cam_from_world is not None and result.covariance is not None
    xi = se3.log(BESIDE @ se3.inverse(result.cam_from_world))
    assert xi @ np.linalg.solve(result.covariance, xi) < 6 * 5.0**2


def test_the_focal_lengths_deviation_is_in_the_covariance(localizer: Localizer) -> None:
    """It adds what the pose moves by when the focal length does."""
    image = room().shoot(PHOTO_CAMERA, BESIDE, samples=2).uint8
    exact = localizer.localize(image, PHOTO_CAMERA)
    unsure = localizer.localize(image, PHOTO_CAMERA.unsure(focal=0.02))
    longer = replace(PHOTO_CAMERA, fx=1.01 * PHOTO_CAMERA.fx, fy=1.01 * PHOTO_CAMERA.fy)
    moved = localizer.localize(image, longer)
    assert exact.covariance is not None and unsure.covariance is not None
    assert exact.aligned is not None and exact.aligned.by_camera is not None
    assert moved.aligned is not None and moved.aligned.cam_from_world is not None
    assert exact.aligned.cam_from_world is not None
    xi = se3.log(moved.aligned.cam_from_world @ se3.inverse(exact.aligned.cam_from_world))
    predicted = exact.aligned.by_camera[:, 0] * np.log(1.01)
    assert np.linalg.norm(xi[:3] - predicted[:3]) < 0.35 * np.linalg.norm(xi[:3])
    added = unsure.covariance - exact.covariance
    direction = exact.aligned.by_camera[:, 0]
    expected = 0.02**2 * np.outer(direction, direction)
    np.testing.assert_allclose(added, expected, rtol=0.05, atol=1e-9)
    assert unsure.camera.focal_sigma == 0.02


def test_the_principal_points_deviation_is_in_the_covariance(localizer: Localizer) -> None:
    """It adds what the pose moves by when either coordinate of the principal point does."""
    image = room().shoot(PHOTO_CAMERA, BESIDE, samples=2).uint8
    exact = localizer.localize(image, PHOTO_CAMERA)
    unsure = localizer.localize(image, PHOTO_CAMERA.unsure(principal=0.01))
    assert exact.covariance is not None and unsure.covariance is not None
    assert exact.aligned is not None and exact.aligned.by_camera is not None
    assert exact.aligned.cam_from_world is not None
    for axis, name in enumerate(("cx", "cy")):
        poses = []
        for off in (0.005, -0.005):
            shifted = getattr(PHOTO_CAMERA, name) + off * PHOTO_CAMERA.fx
            moved = localizer.localize(image, replace(PHOTO_CAMERA, **{name: shifted})).aligned
            assert moved is not None and moved.cam_from_world is not None
            poses.append(moved.cam_from_world)
        xi = se3.log(poses[0] @ se3.inverse(poses[1]))
        predicted = 0.01 * exact.aligned.by_camera[:, 2 + axis]
        for half, share in ((slice(0, 3), 0.35), (slice(3, 6), 0.1)):
            assert np.linalg.norm(xi[half] - predicted[half]) < share * np.linalg.norm(xi[half])
    added = unsure.covariance - exact.covariance
    by_principal = exact.aligned.by_camera[:, 2:4]
    expected = 0.01**2 * by_principal @ by_principal.T
    np.testing.assert_allclose(added, expected, rtol=0.05, atol=1e-9)


def test_an_estimated_camera_says_how_sure_it_is(localizer: Localizer) -> None:
    image = room().shoot(PHOTO_CAMERA, BESIDE, samples=2).uint8
    camera = localizer.estimate_camera(image)
    assert 0 < camera.focal_sigma < 0.03
    assert 0 < camera.covariance[2][2] < 2 * IntrinsicsSettings().principal_sigma ** 2
    assert abs(np.log(camera.fx / PHOTO_CAMERA.fx)) < 4.0 * camera.focal_sigma
    result = localizer.localize(image, camera)
    assert result.cam_from_world is not None and result.covariance is not None
    xi = se3.log(BESIDE @ se3.inverse(result.cam_from_world))
    assert xi @ np.linalg.solve(result.covariance, xi) < 40.0
