# SPDX-License-Identifier: Apache-2.0
"""The agreement of photo and render: blind to light, not to place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera

from gscpe.geometry import Camera, se3
from gscpe.photos import luminance
from gscpe.refinement.agreement import photometric_agreement
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel

CAMERA = room_camera(160, 120)
VALID = np.ones((120, 160), dtype=bool)
STEP = np.array([0.03, -0.02, 0.04, 0.01, -0.02, 0.05])


def picture(pose: NDArray[np.float64] = ROOM_POSE, seed: int = 0) -> NDArray[np.float32]:
    return luminance(room(seed).shoot(CAMERA, pose).rgb.astype(np.float32))


def agreement(
    photo: NDArray[np.floating],
    step: NDArray[np.float64] | None = None,
    valid: NDArray[np.bool_] = VALID,
    anchor: NDArray[np.float32] | None = None,
    camera: Camera = CAMERA,
) -> tuple[float, float]:
    image = picture() if anchor is None else anchor
    level = AnchorLevel(image, valid, CAMERA, room().shoot(CAMERA, ROOM_POSE).depth)
    photo_level = ImageLevel(photo.astype(np.float32), VALID, camera)
    return photometric_agreement(level, photo_level, np.eye(4) if step is None else se3.exp(step))


def test_the_same_place() -> None:
    correlation, overlap = agreement(picture())
    assert correlation > 0.95
    assert overlap == pytest.approx(1.0, abs=0.02)  # but for the outermost pixels


def test_a_moved_camera_is_compensated() -> None:
    photo = picture(se3.exp(STEP) @ ROOM_POSE)
    assert agreement(photo, STEP)[0] > 0.9
    assert agreement(photo)[0] < 0.5  # without the right pose it does not fit


def test_gain_bias_and_vignetting_do_not_count() -> None:
    v, u = np.mgrid[-1:1:120j, -1:1:160j]
    vignetting = 1.0 - 0.3 * (u**2 + v**2)
    plain, _ = agreement(picture())
    changed, _ = agreement(0.5 * vignetting * picture() + 0.2)
    assert changed > plain - 0.03


def test_another_place_does_not_agree() -> None:
    correlation, _ = agreement(picture(seed=77))
    assert abs(correlation) < 0.2


def test_negatives_disagree() -> None:
    assert agreement(1.0 - picture())[0] < -0.95


def test_a_flat_photo_of_a_textured_place_disagrees() -> None:
    correlation, overlap = agreement(np.full((120, 160), 0.4))
    assert abs(correlation) < 0.05
    assert overlap > 0.9


def test_a_flat_render_of_a_textured_place_disagrees() -> None:
    correlation, _ = agreement(picture(), anchor=np.full((120, 160), 0.4, np.float32))
    assert abs(correlation) < 0.05


def test_two_flat_pictures_have_nothing_to_compare() -> None:
    flat = np.full((120, 160), 0.4, np.float32)
    correlation, overlap = agreement(flat, anchor=flat)
    assert np.isnan(correlation)
    assert overlap > 0.9


def test_overlap_is_the_share_that_both_show() -> None:
    half = VALID.copy()
    half[:, :80] = False
    assert agreement(picture(), valid=half)[1] == pytest.approx(0.5, abs=0.02)
    # A photo that is shifted by a quarter of the picture.
    camera = replace(CAMERA, cx=CAMERA.cx + 40)
    shifted = luminance(room().shoot(camera, ROOM_POSE).rgb.astype(np.float32))
    correlation, overlap = agreement(shifted, camera=camera)
    assert correlation > 0.95
    assert overlap == pytest.approx(0.75, abs=0.02)


@pytest.mark.parametrize("turn", [1.3, np.pi])
def test_no_overlap(turn: float) -> None:
    correlation, overlap = agreement(picture(), np.array([0, 0, 0, 0, turn, 0]))
    assert np.isnan(correlation)
    assert overlap == 0.0
