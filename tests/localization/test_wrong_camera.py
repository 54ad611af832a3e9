# SPDX-License-Identifier: Apache-2.0
"""Given cameras that are wrong: said so, with what to do, or in the covariance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_map

from gscpe import Localizer, VerificationSettings
from gscpe.arrays import UInt8Array
from gscpe.coarse import CameraEstimate, CoarseResult
from gscpe.errors import CameraError, SettingsError
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.geometry.intrinsics import changed_camera
from gscpe.localization.verification import doubt_about_coarse
from gscpe.localization.wrong_camera import (
    CameraCheckSettings,
    contradiction,
    doubt_about_camera,
    excess,
)

CAMERA = Camera.pinhole(640, 480, fx=525.0, fy=525.0, cx=320.0, cy=240.0)
SETTINGS = CameraCheckSettings()


def coarse(
    change: list[float], sigmas: float | list[float] = 0.001, inliers: int = 90
) -> CoarseResult:
    """Of matches that ask for a change; 60 of 100 agree with the pose of the given camera."""
    covariance = np.diag(np.broadcast_to(np.square(sigmas), 5))
    asked = changed_camera(CAMERA, np.array(change))
    estimate = CameraEstimate(asked, np.eye(4), np.array(change), covariance, inliers)
    pixels = np.stack(np.meshgrid(np.arange(20.0, 640, 80), np.arange(20.0, 480, 60)), -1)
    return CoarseResult(
        cam_from_world=np.eye(4),
        covariance=1e-6 * np.eye(6),
        matches=100,
        inliers=60,
        inlier_pixels=pixels.reshape(-1, 2)[:60],
        rms_pixels=0.8,
        rounds=2,
        converged=True,
        intrinsics=estimate,
        rival_pixels=np.zeros((0, 2)),
    )


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ([0.15, 0, 0, 0, 0], "fit 1.16 times the camera's focal length: give the correct"),
        ([0, 0.04, 0, 0, 0], "fit fy = 1.04 fx, not the camera's 1 fx: give the correct"),
        ([0, 0, 0.03, -0.04, 0], "a principal point that is 5.0% of the focal length away"),
        ([0, 0, 0, 0, -0.21], "ask for k1 = -0.21 beyond the camera's distortion: declare"),
    ],
)
def test_what_is_wrong_and_what_to_do(change: list[float], reason: str) -> None:
    doubt = doubt_about_camera(coarse(change), CAMERA, SETTINGS)
    assert doubt is not None and reason in doubt
    assert doubt_about_coarse(coarse(change), CAMERA, VerificationSettings()) == doubt
    assert excess(coarse(change), CAMERA, SETTINGS) > 1.0


@pytest.mark.parametrize("number", range(5))
def test_what_is_small_or_chance_is_no_doubt(number: int) -> None:
    small = [0.0] * 5
    small[number] = 0.9 * float(SETTINGS.limits[number])
    assert doubt_about_camera(coarse(small), CAMERA, SETTINGS) is None
    large = [0.0] * 5
    large[number] = 3.0 * float(SETTINGS.limits[number])
    assert doubt_about_camera(coarse(large), CAMERA, SETTINGS) is not None
    assert doubt_about_camera(coarse(large, sigmas=0.1), CAMERA, SETTINGS) is None
    unsure = CAMERA.unsure(focal=0.1, aspect=0.1, principal=0.1, radial=0.1)
    assert doubt_about_camera(coarse(large), unsure, SETTINGS) is None
    nothing = contradiction(coarse(large, sigmas=0.1), CAMERA, SETTINGS)
    assert not nothing.change.any() and not nothing.covariance.any()


def test_what_is_small_makes_the_camera_unsure() -> None:
    """By the whole change, and by what of it is not known."""
    found = contradiction(coarse([0.0, 0.0, 0.014, 0.0, 0.0]), CAMERA, SETTINGS)
    assert 0.7 * 0.014 < np.sqrt(found.covariance[2, 2]) < 0.014
    assert 0.0005 < np.sqrt(found.covariance[3, 3]) < 0.001
    focal = contradiction(coarse([0.02, 0.0, 0.0, 0.0, 0.0]), CAMERA, SETTINGS)
    assert 0.018 < np.sqrt(focal.covariance[0, 0]) < 0.02
    # It is the focal length alone, so that the others are not in doubt.
    assert np.count_nonzero(focal.covariance) == 1


def test_the_camera_is_the_reason_where_few_matches_agree_with_it() -> None:
    """More than 15% off, only matches of one depth agree with the given focal length; but nearly
    all with another one. What agrees with nothing is no reason."""
    far_off = replace(coarse([0.3, 0.0, 0.0, 0.0, 0.0]), inliers=12)
    doubt = doubt_about_coarse(far_off, CAMERA, VerificationSettings())
    assert doubt is not None and "1.35 times the camera's focal length" in doubt
    nonsense = replace(coarse([0.3, 0.0, 0.0, 0.0, 0.0], inliers=15), inliers=12)
    doubt = doubt_about_coarse(nonsense, CAMERA, VerificationSettings())
    assert doubt is not None and "only 12 matches agree with a pose" in doubt
    nothing = replace(far_off, intrinsics=None, inliers=60)
    assert doubt_about_coarse(nothing, CAMERA, VerificationSettings()) is None


@pytest.mark.parametrize(
    "wrong", [{"max_radial_error": 0.0}, {"tolerance": -1.0}, {"chance": float("nan")}]
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        CameraCheckSettings(**wrong)


PHOTO_CAMERA = Camera.pinhole(320, 240, fx=260.0, fy=260.0, cx=160.0, cy=120.0)
BESIDE = np.asarray(se3.exp([0.08, -0.05, 0.06, 0.03, -0.03, 0.04]) @ ROOM_POSE)


@pytest.fixture(scope="module")
def localizer() -> Iterator[Localizer]:
    with Localizer(room_map()) as localizer:
        yield localizer


def photo(camera: Camera, pose: NDArray[np.float64] = BESIDE) -> UInt8Array:
    return room().shoot(camera, pose, samples=2).uint8


WRONG = {
    "fy": replace(PHOTO_CAMERA, fy=1.06 * PHOTO_CAMERA.fy),
    "cy": replace(PHOTO_CAMERA, cy=PHOTO_CAMERA.cy + 16.0),
    "f": replace(PHOTO_CAMERA, fx=1.3 * PHOTO_CAMERA.fx, fy=1.3 * PHOTO_CAMERA.fy),
}


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_camera_is_never_far_off_with_confidence(kind: str, localizer: Localizer) -> None:
    result = localizer.localize(photo(PHOTO_CAMERA), WRONG[kind])
    if not result.localized:
        assert result.reason is not None and "intrinsics" in result.reason, result.reason
        return
    assert kind == "cy"
    assert result.cam_from_world is not None and result.covariance is not None
    xi = se3.log(BESIDE @ se3.inverse(result.cam_from_world))
    assert xi @ np.linalg.solve(result.covariance, xi) < 6 * 5.0**2


@pytest.mark.parametrize("k1", [-0.25, 0.2])
def test_distortion_that_nobody_declared(k1: float, localizer: Localizer) -> None:
    """It is refused with what to do; and with that, or with a camera that the map estimates, the
    photo is localized."""
    lens = replace(PHOTO_CAMERA, distortion=(k1, *(0.0,) * 7))
    image = photo(lens)
    result = localizer.localize(image, PHOTO_CAMERA)
    assert not result.localized
    assert result.reason is not None and "declare the distortion" in result.reason
    estimated = localizer.estimate_camera(image)
    assert estimated.distortion and abs(estimated.distortion[0] - k1) < 0.1
    for camera in (lens, estimated):
        result = localizer.localize(image, camera)
        assert result.cam_from_world is not None and result.covariance is not None, result.reason
        xi = se3.log(BESIDE @ se3.inverse(result.cam_from_world))
        assert xi @ np.linalg.solve(result.covariance, xi) < 40.0
        nearest = 0.03 if camera is lens else 0.15  # so far out, nothing is expected beforehand
        assert pose_difference(result.cam_from_world, BESIDE).distance < nearest


def test_one_camera_of_several_photos(localizer: Localizer) -> None:
    poses = [BESIDE, ROOM_POSE, np.asarray(se3.exp([-0.1, 0.04, 0, 0, 0.05, -0.02]) @ ROOM_POSE)]
    true = replace(PHOTO_CAMERA, fy=1.004 * PHOTO_CAMERA.fy, cx=163.0)
    images = [photo(true, pose) for pose in poses]
    blank = np.full_like(images[0], 128)
    camera = localizer.estimate_camera([*images, blank])  # what tells nothing is left out
    alone = localizer.estimate_camera(images[0])
    assert camera.focal_sigma < alone.focal_sigma
    assert abs(np.log(camera.fx / true.fx)) < 4.0 * camera.focal_sigma < 0.03
    assert abs(camera.cx - true.cx) < 3.0
    with pytest.raises(CameraError, match="all of one size"):
        localizer.estimate_camera([images[0], images[1][:200]])
    with pytest.raises(CameraError, match="one photo or more"):
        localizer.estimate_camera([])
    with pytest.raises(CameraError, match="cannot be estimated"):
        localizer.estimate_camera([blank, blank])


def test_a_guess_with_distortion_or_a_fisheye(localizer: Localizer) -> None:
    """What the guess knows of the lens is kept."""
    lens = replace(PHOTO_CAMERA, distortion=(-0.2, *(0.0,) * 7))
    image = photo(lens)
    guess = replace(lens, fx=300.0, fy=300.0, distortion=(-0.25, *(0.0,) * 7))
    camera = localizer.estimate_camera(image, guess)
    assert abs(camera.distortion[0] + 0.2) < 0.1
    assert camera.fx == pytest.approx(260.0, rel=0.02)
    with pytest.raises(CameraError, match="fisheye"):
        localizer.estimate_camera(image, replace(PHOTO_CAMERA, fisheye=True))
