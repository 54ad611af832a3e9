# SPDX-License-Identifier: Apache-2.0
"""Whole runs on photos that are dark, white, partly transparent, or of a fisheye."""

from __future__ import annotations

import re
from typing import Any, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import Localizer
from gscpe.errors import CameraError
from gscpe.geometry import Camera, pose_difference, se3

CAMERA = room_camera(240, 180)
POSE = se3.exp([0.05, -0.03, 0.04, 0.02, -0.02, 0.03]) @ ROOM_POSE


@pytest.fixture(scope="module")
def localizer() -> Iterator[Localizer]:
    with Localizer(room_map(), matcher="sift") as localizer:
        yield localizer


@pytest.fixture
def photo() -> NDArray[np.uint8]:
    return room().shoot(CAMERA, POSE, samples=2).uint8


def test_the_transparent_part_of_a_photo_does_not_count(
    localizer: Localizer, photo: NDArray[np.uint8]
) -> None:
    """What is under it is of another place: without the mask, it would be taken for the photo."""
    alpha = np.full((180, 240), 255, np.uint8)
    alpha[:, :100] = 0
    photo[:, :100] = photo[:, 140:]
    result = localizer.localize(np.dstack([photo, alpha]), CAMERA)
    assert result.localized, result.reason
    assert result.cam_from_world is not None
    error = pose_difference(result.cam_from_world, POSE)
    assert error.distance < 8e-3
    assert error.degrees < 0.2
    whole = localizer.localize(room().shoot(CAMERA, POSE, samples=2).uint8, CAMERA)
    assert result.aligned is not None
    assert whole.aligned is not None
    assert result.aligned.pixels < 0.65 * whole.aligned.pixels


@pytest.mark.parametrize(
    "text",
    [
        "OPENCV_FISHEYE,240,180,160,158,118,93,0.05,-0.02,0.003,0",
        "THIN_PRISM_FISHEYE,240,180,160,158,118,93,0.05,-0.02,0.004,-0.003,0.003,0,0.01,-0.004",
    ],
)
def test_a_fisheye_photo(text: str, localizer: Localizer) -> None:
    """86 degrees wide; taken for a pinhole's, it is 2 cm off or more, or not localized."""
    camera = Camera.parse(text)
    photo = room().shoot(camera, POSE).uint8
    result = localizer.localize(photo, camera)
    assert result.localized, result.reason
    assert result.cam_from_world is not None
    error = pose_difference(result.cam_from_world, POSE)
    assert error.distance < 8e-3
    assert error.degrees < 0.2


def _spoilt(photo: NDArray[np.uint8], share: float, value: int) -> NDArray[np.uint8]:
    """A photo that shows something in its lowest rows only."""
    spoilt = photo.copy()
    spoilt[: round(share * len(photo))] = value
    return spoilt


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda p: p // 127, r"almost black \(brightest value [12] of 255\)"),
        (lambda p: p * 0, r"almost black \(brightest value 0 of 255\)"),
        (lambda p: 252 + p // 100, r"almost white \(darkest value 252 of 255\)"),
        (lambda p: np.dstack([p, p[:, :, :1] * 0]), "whole photo is masked"),
        (lambda p: _spoilt(p, 0.9, 3), r"9[01]% of the photo is black: expose it longer"),
        (lambda p: _spoilt(p, 0.9, 255), r"9[01]% of the photo is white: expose it for a shorter"),
    ],
)
def test_the_reason_is_the_light(
    change: object, reason: str, localizer: Localizer, photo: NDArray[np.uint8]
) -> None:
    assert callable(change)
    spoilt = change(photo).astype(np.uint8)
    spoilt[5, 7, :3] = 255 - spoilt[5, 7, 0]  # a pixel that is stuck changes nothing
    result = localizer.localize(spoilt, CAMERA)
    assert not result.localized
    assert re.search(reason, result.reason or "")
    try:  # what is left of a dark photo may tell the focal length, and not the place
        estimated = localizer.estimate_camera(spoilt)
    except CameraError as error:
        assert re.search(reason, str(error))
    else:
        assert estimated.fx == pytest.approx(CAMERA.fx, rel=0.05)


def test_ordinary_reasons_stay(localizer: Localizer) -> None:
    grey = np.full((180, 240, 3), 120, np.uint8)
    assert localizer.localize(grey, CAMERA).reason == (
        "the photo has no features to recognize a place by: try one with more edges and texture "
        "in view"
    )


def test_a_guess_that_is_no_camera_is_refused(
    localizer: Localizer, photo: NDArray[np.uint8]
) -> None:
    guess: Any
    for guess in ("PINHOLE,240,180,200,200,120,90", 200.0):
        with pytest.raises(CameraError, match="the guess must be a Camera or None"):
            localizer.estimate_camera(photo, guess)
