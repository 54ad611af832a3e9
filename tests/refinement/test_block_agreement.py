# SPDX-License-Identifier: Apache-2.0
"""The quick agreement, in a template's pixels, says what the exact one says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera

from gscpe.geometry import se3
from gscpe.photos import luminance
from gscpe.refinement import LucasKanadeSettings
from gscpe.refinement.agreement import BlockAgreement, block_agreement, photometric_agreement
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.template import build_template
from gscpe.refinement.uncertainty import blocks_of

CAMERA = room_camera(160, 120)
STEP = np.array([0.03, -0.02, 0.04, 0.01, -0.02, 0.05])
SHOT = room().shoot(CAMERA, ROOM_POSE)
VALID = np.ones((120, 160), dtype=bool)
GREY = luminance(SHOT.rgb.astype(np.float32))


def picture(pose: NDArray[np.float64] = ROOM_POSE, seed: int = 0) -> NDArray[np.float32]:
    return luminance(room(seed).shoot(CAMERA, pose).rgb.astype(np.float32))


def agreements(
    photo: NDArray[np.floating],
    step: NDArray[np.float64] | None = None,
    grey: NDArray[np.float32] = GREY,
) -> tuple[BlockAgreement, float]:
    anchor = AnchorLevel(grey, VALID, CAMERA, SHOT.depth)
    level = ImageLevel(photo.astype(np.float32), VALID, CAMERA)
    template = build_template(anchor, LucasKanadeSettings(max_template_pixels=5000))
    assert template is not None
    pose = np.eye(4) if step is None else se3.exp(step)
    quick = block_agreement(template, level, pose, blocks_of(template, CAMERA, 10))
    return quick, photometric_agreement(anchor, level, pose)[0]


@pytest.mark.parametrize(
    ("photo", "step"),
    [
        (picture(), None),
        (0.4 * picture() + 0.3, None),
        (picture(se3.exp(STEP) @ ROOM_POSE), STEP),
        (picture(se3.exp(STEP) @ ROOM_POSE), None),
        (picture(seed=77), None),
        (1.0 - picture(), None),
    ],
)
def test_as_the_exact_one(photo: NDArray[np.float32], step: NDArray[np.float64] | None) -> None:
    quick, exact = agreements(photo, step)
    assert quick.correlation == pytest.approx(exact, abs=0.12)


def test_the_share_of_the_picture_that_is_alike() -> None:
    covered = picture()
    covered[:, :64] = 0.4
    quick, _ = agreements(covered)
    assert quick.alike == pytest.approx(0.6, abs=0.05)
    assert quick.correlation == pytest.approx(0.6, abs=0.05)
    assert quick.overlap > 0.95


def test_overlap() -> None:
    turned = np.array([0, 0, 0, 0, 0.28, 0.0])
    quick, _ = agreements(picture(se3.exp(turned) @ ROOM_POSE), turned)
    assert 0.55 < quick.overlap < 0.85
    assert quick.correlation > 0.9


def test_nothing_to_compare() -> None:
    flat = np.full((120, 160), 0.4, dtype=np.float32)
    quick, _ = agreements(flat, grey=flat)
    assert np.isnan(quick.correlation)
    assert quick.alike == 0.0
    one_flat, _ = agreements(flat)
    assert abs(one_flat.correlation) < 0.05
