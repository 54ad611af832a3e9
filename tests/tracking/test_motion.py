# SPDX-License-Identifier: Apache-2.0
"""Where a camera is expected."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import random_pose
from hypothesis import given
from hypothesis import strategies as st

from gscpe import Motion
from gscpe.errors import PoseError
from gscpe.geometry import se3
from gscpe.tracking.carry import joined
from gscpe.tracking.motion import MotionState

seeds = st.integers(0, 2**31)


@given(seeds, st.floats(0.2, 5.0))
def test_a_constant_twist_is_predicted_exactly(seed: int, ratio: float) -> None:
    """Whatever the poses, the twist, and the times between frames."""
    rng = np.random.default_rng(seed)
    first, twist = random_pose(rng), rng.normal(0.0, 0.2, 6)
    start, dt = rng.uniform(0, 1e6), rng.uniform(0.01, 1.0)
    second = se3.exp(dt * twist) @ first
    state = MotionState.at_rest(first, start).seen(second, start + dt, 0.0)
    expected = state.predicted(start + dt + ratio * dt).cam_from_world
    np.testing.assert_allclose(expected, se3.exp(ratio * dt * twist) @ second, atol=1e-7)


def test_frames_that_were_not_seen_are_bridged_by_the_same_twist() -> None:
    twist = np.array([0.1, 0.0, -0.05, 0.01, 0.2, 0.0])
    state = MotionState.at_rest(np.eye(4), 0.0).seen(se3.exp(twist), 1.0, 0.0)
    for time in (2.0, 3.5, 4.0):
        state = state.not_seen(time)
    assert state.unseen == 3
    np.testing.assert_allclose(state.cam_from_world, se3.exp(4.0 * twist), atol=1e-12)
    # A pose that was then seen does not spoil the velocity: the last pose was only expected.
    again = state.seen(se3.exp([0.3, 0, 0, 0, 0, 0]) @ state.cam_from_world, 5.0, 4.0)
    np.testing.assert_allclose(again.velocity, twist, atol=1e-12)
    assert again.unseen == 0


@given(seeds, st.integers(1, 6))
def test_measured_motions_lead_exactly(seed: int, frames: int) -> None:
    """The chain of what odometry says, whether frames showed something or not."""
    rng = np.random.default_rng(seed)
    state = MotionState.at_rest(random_pose(rng), 0.0)
    truth = state.cam_from_world
    for index in range(1, frames + 1):
        moved = se3.exp(rng.normal(0.0, 0.3, 6))
        truth = moved @ truth
        state = state.not_seen(float(index), Motion(moved, 0.02, 1.0))
    np.testing.assert_allclose(state.cam_from_world, truth, atol=1e-9)
    # Independent motions: variances add.
    expected = np.sqrt(frames) * np.repeat([0.02, np.radians(1.0)], 3)
    np.testing.assert_allclose(state.sigmas, expected)


@given(seeds)
def test_joined_motions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = (Motion(random_pose(rng), 3.0, 0.6) for _ in range(2))
    both = joined(first, second)
    assert both is not None
    pose = random_pose(rng)
    np.testing.assert_allclose(
        both.cam_from_previous_cam @ pose,
        second.cam_from_previous_cam @ (first.cam_from_previous_cam @ pose),
        atol=1e-12,
    )
    assert both.translation_sigma == pytest.approx(3.0 * np.sqrt(2))
    assert both.rotation_sigma == pytest.approx(0.6 * np.sqrt(2))
    assert joined(first, None) is joined(None, second) is None


def test_the_expected_error_in_pixels() -> None:
    """A camera 2 m before a wall, f = 500: a centimetre is 2.5 pixels."""
    at_rest = MotionState.at_rest(np.eye(4), 0.0)
    state = at_rest.seen(np.eye(4), 1.0, 0.0)
    motion_matrix = np.diag([250.0**2, 250.0**2, 1.0, 500.0**2, 500.0**2, 1.0])
    measured = Motion(np.eye(4), translation_sigma=0.01, rotation_sigma=1e-9)
    pixels = state.predicted(2.0, measured).pixels(motion_matrix)
    assert pixels == pytest.approx(2.5 * np.sqrt(2), rel=1e-3)
    # Surprises are remembered, and soon forgotten.
    surprised = state.seen(np.eye(4), 2.0, 12.0)
    assert surprised.surprise_pixels >= 0.7 * 12.0
    for time in range(3, 12):
        surprised = surprised.seen(np.eye(4), float(time), 0.0)
    assert surprised.surprise_pixels < 1.0


@pytest.mark.parametrize(
    "arguments",
    [
        (np.zeros((4, 4)),),
        (np.eye(3),),
        (np.eye(4), 0.0),
        (np.eye(4), 0.1, -1.0),
        (np.eye(4), np.nan),
        (np.eye(4), [0.1, 0.1, 0.1]),
        (np.eye(4), 0.1, "small"),
    ],
)
def test_what_is_no_motion(arguments: tuple[object, ...]) -> None:
    with pytest.raises(PoseError):
        Motion(*arguments)  # type: ignore[arg-type]


def test_a_motion_cannot_be_changed() -> None:
    given_pose = np.eye(4)
    motion = Motion(given_pose)
    given_pose[0, 3] = 1.0
    assert motion.cam_from_previous_cam[0, 3] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        motion.cam_from_previous_cam[0, 3] = 1.0
