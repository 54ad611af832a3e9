# SPDX-License-Identifier: Apache-2.0
"""An old answer is carried forward to the current frame."""

from __future__ import annotations

import numpy as np
import pytest
from moving_camera import CAMERA, black, picture, pose
from numpy.typing import NDArray
from scenes import RayCastRenderer, room

from gscpe import Motion, TrackingSettings, pose_difference
from gscpe.geometry import se3
from gscpe.tracking.anchors import Anchor, make_anchor
from gscpe.tracking.carry import Carried, KeptFrames, carry_forward
from gscpe.tracking.frames import Frame, FrameMaker
from gscpe.tracking.motion import MotionState

SETTINGS = TrackingSettings()
MAKER = FrameMaker(lambda camera: 1.0, SETTINGS.levels)


def render(cam_from_world: NDArray[np.float64]) -> Anchor:
    renderer = RayCastRenderer(room())
    anchor = make_anchor(renderer, CAMERA, cam_from_world, SETTINGS, 1.0, 0)
    assert anchor is not None
    return anchor


def frame(index: int, image: NDArray[np.uint8], motion: Motion | None = None) -> Frame:
    return MAKER.frame(image, CAMERA, index, float(index), motion)


def found_at(index: int) -> Carried:
    return Carried(MotionState.at_rest(pose(index), float(index)), render(pose(index)))


def measured(before: int, after: int) -> Motion:
    return Motion(pose(after) @ se3.inverse(pose(before)), 0.002, 0.1)


def test_the_frames_since_then_are_followed() -> None:
    kept = KeptFrames(60)
    for index in range(1, 16):
        kept.add(frame(index, picture(index)))
    carried = carry_forward(found_at(0), kept, render, SETTINGS)
    assert len(kept) == 0
    assert carried.state.time == 15.0
    assert carried.state.unseen == 0
    error = pose_difference(carried.state.cam_from_world, pose(15))
    assert error.distance < 0.03  # pictures of 60x45 pixels
    assert error.degrees < 0.6
    assert carried.anchor.pixels_to(pose(15)) < 48


def test_where_nothing_is_seen_the_measured_motion_leads() -> None:
    kept = KeptFrames(60)
    for index in range(1, 6):
        kept.add(frame(index, black(), measured(index - 1, index)))
    carried = carry_forward(found_at(0), kept, render, SETTINGS)
    assert carried.state.unseen == 5
    np.testing.assert_allclose(carried.state.cam_from_world, pose(5), atol=1e-9)


def test_too_many_frames_lose_every_second_but_no_motion() -> None:
    kept = KeptFrames(4)
    for index in range(1, 12):
        kept.add(frame(index, black(), measured(index - 1, index)))
        assert len(kept) <= 4
    carried = carry_forward(found_at(0), kept, render, SETTINGS)
    assert carried.state.time == 11.0
    np.testing.assert_allclose(carried.state.cam_from_world, pose(11), atol=1e-9)


def test_it_can_be_stopped() -> None:
    kept = KeptFrames(60)
    kept.add(frame(1, picture(1)))
    carried = carry_forward(found_at(0), kept, render, SETTINGS, lambda: True)
    assert carried.state.time == 0.0
    assert len(kept) == 1


@pytest.mark.parametrize("index", [0, 1])
def test_kept_frames_are_small(index: int) -> None:
    kept = KeptFrames(3)
    kept.add(frame(index, picture(index)))
    taken = kept.take()
    assert taken is not None
    assert taken.levels[0].image.shape == (45, 60)
    assert kept.take() is None
