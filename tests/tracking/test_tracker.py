# SPDX-License-Identifier: Apache-2.0
"""Whole runs: a camera that is followed, lost, and found."""

from __future__ import annotations

import gc
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from moving_camera import CAMERA, black, foreign, picture, pose, right, until_found
from scenes import room

from gscpe import (
    Localizer,
    Motion,
    Tracker,
    TrackingResult,
    TrackingSettings,
    TrustSettings,
)
from gscpe.geometry import se3
from gscpe.refinement import LucasKanadeSettings
from gscpe.tracking.anchors import Anchor
from gscpe.tracking.follow import Judge


def until_lost(tracker: Tracker, index: float, seconds: float = 60.0) -> TrackingResult:
    """The same, until its pose is not known any more."""
    end = time.monotonic() + seconds
    while True:
        result = tracker.track(picture(index), CAMERA)
        if result.status == "lost" or time.monotonic() > end:
            return result


@pytest.mark.parametrize("rate", [None, 30.0])
def test_follows_a_camera(tracker: Tracker, rate: float | None) -> None:
    """Whether it knows the times or not."""
    times = [None if rate is None else 1e9 + index / rate for index in range(12)]
    results = [
        tracker.track(picture(index), CAMERA, time=seconds) for index, seconds in enumerate(times)
    ]
    assert [result.status for result in results] == ["relocalized", *(11 * ["tracking"])]
    for index, result in enumerate(results):
        right(result, pose(index))
        assert result.milliseconds > 0
        assert result.anchor_age is not None
        assert 0 <= result.anchor_age <= index
        assert result.agreement > 0.6


def test_all_pixels_are_asked_before_a_frame_is_lost(
    tracker: Tracker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The few pixels by which frames are judged may say too little of a blurred one."""
    monkeypatch.setattr(Judge, "covariance", lambda *_: 1e6 * np.eye(6))
    results = [tracker.track(picture(index), CAMERA) for index in range(4)]
    assert [result.status for result in results] == ["relocalized", *(3 * ["tracking"])]
    for index, result in enumerate(results):
        right(result, pose(index))
        assert result.covariance is not None
        assert np.sqrt(np.trace(result.covariance)) < 0.05


def test_anchors_are_rendered_on_the_way(localizer: Localizer) -> None:
    """Frames wait for the next one before the last is 6 pixels away."""
    settings = TrackingSettings(wait=True, anchor_pixels=4.0, farthest_pixels=6.0)
    with Tracker(localizer, settings) as tracker:
        results = [tracker.track(picture(index), CAMERA) for index in range(12)]
    ages = [result.anchor_age for result in results if result.anchor_age is not None]
    assert len(ages) == 12
    assert sum(later <= earlier for earlier, later in pairwise(ages)) >= 2
    right(results[-1], pose(11))


def test_poses_stay_rigid_over_many_anchors(localizer: Localizer) -> None:
    """A rotation that is a little off is off three times as much after each anchor, unless it is
    mended: 25 of them would spoil it."""
    settings = TrackingSettings(wait=True, anchor_pixels=1.0, farthest_pixels=1.0)
    there_and_back = [*range(6), *range(4, 0, -1)] * 12
    with Tracker(localizer, settings) as tracker:
        results = [tracker.track(picture(index), CAMERA) for index in there_and_back]
    asked = {index - (result.anchor_age or 0) for index, result in enumerate(results)}
    assert len(asked) > 30
    rotation = np.asarray(results[-1].cam_from_world)[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    right(results[-1], pose(there_and_back[-1]))


def test_measured_motion_leads_where_the_velocity_does_not(tracker: Tracker) -> None:
    """A camera that starts, and jerks by 25 pixels a frame."""
    at = [0.0, 0.0, 12.0, 3.0, 14.0]
    tracker.track(picture(at[0]), CAMERA)
    for before, index in pairwise(at):
        measured = pose(index) @ se3.inverse(pose(before))
        result = tracker.track(picture(index), CAMERA, motion=Motion(measured))
        assert result.status == "tracking", result.reason
        right(result, pose(index))


def test_frames_that_show_nothing_are_lost_and_the_camera_is_found_again(
    tracker: Tracker,
) -> None:
    for index in range(3):
        tracker.track(picture(index), CAMERA)
    for image, words in ((black(), "almost black"), (255 - black(), "almost white")):
        result = tracker.track(image, CAMERA)
        assert result.status == "lost"
        assert result.reason is not None and words in result.reason
        assert result.cam_from_world is None and result.covariance is None
    result = tracker.track(picture(5), CAMERA)
    assert result.status == "relocalized"
    right(result, pose(5))
    assert tracker.track(picture(6), CAMERA).status == "tracking"


def test_pictures_of_another_place_are_lost(tracker: Tracker) -> None:
    tracker.track(picture(0), CAMERA)
    result = tracker.track(foreign(), CAMERA)
    assert result.status == "lost"
    assert result.reason is not None and "correlation" in result.reason
    result = tracker.track(picture(1), CAMERA)
    assert result.status == "relocalized"
    right(result, pose(1))


def test_a_fifth_covered_is_still_followed(tracker: Tracker) -> None:
    tracker.track(picture(0), CAMERA)
    for index in range(1, 4):
        covered = picture(index).copy()
        covered[:, :48] = (90, 70, 60)
        result = tracker.track(covered, CAMERA)
        assert result.status == "tracking", result.reason
        right(result, pose(index))


def test_a_jump_is_found_with_the_localizer(localizer: Localizer) -> None:
    """Further than an alignment reaches, the camera rolled by 45 degrees. It looks like another
    place, so that the localizer is asked at once, without patience."""
    rolled = se3.exp([0, 0, 0, 0, 0, 0.8]) @ pose(3)
    image = room().shoot(CAMERA, rolled).uint8
    with Tracker(localizer, TrackingSettings(wait=True, patience=100)) as tracker:
        for index in range(3):
            tracker.track(picture(index), CAMERA)
        results = [tracker.track(image, CAMERA) for _ in range(3)]
    assert [result.status for result in results] == ["relocalized", "tracking", "tracking"]
    for result in results:
        right(result, rolled)


def test_a_jump_after_one_bad_frame_is_found(localizer: Localizer) -> None:
    """One search in vain says nothing of the next frame; after several, some are left out."""
    rolled = se3.exp([0, 0, 0, 0, 0, 0.8]) @ pose(3)
    image = room().shoot(CAMERA, rolled).uint8
    with Tracker(localizer, TrackingSettings(wait=True)) as tracker:
        tracker.track(picture(0), CAMERA)
        assert tracker.track(foreign(), CAMERA).status == "lost"
        found = tracker.track(image, CAMERA)
        assert found.status == "relocalized", found.reason
        right(found, rolled)
        for _ in range(3):
            assert tracker.track(foreign(), CAMERA).status == "lost"
        left_out = [tracker.track(foreign(), CAMERA).reason or "" for _ in range(4)]
    assert sum("not looked for" in reason for reason in left_out) == 3


def test_no_frame_waits_for_the_localizer_unless_told_to(localizer: Localizer) -> None:
    """The first answer is about an old frame: it is carried forward to where the camera is."""
    with Tracker(localizer, TrackingSettings(kept_frames=8)) as tracker:
        first = tracker.track(picture(0), CAMERA)
        assert first.status == "lost"
        assert first.reason is not None and "the localizer is at work" in first.reason
        for index in range(1, 10):
            result = tracker.track(picture(index), CAMERA)
        result = until_found(tracker, 9)
        assert result.status == "relocalized", result.reason
        right(result, pose(9))
        assert tracker.track(picture(10), CAMERA).status == "tracking"


SLOW = LucasKanadeSettings(max_iterations=1, converged_pixels=0.03)


"""One step is too few for an alignment that begins a dozen pixels away, not for one near by."""


def test_a_frame_that_may_wait_gets_a_render_of_its_own(localizer: Localizer) -> None:
    """A camera that jerks: the alignment ends near the pose, but does not converge."""
    settings = TrackingSettings(wait=True, farthest_pixels=100.0, solver=SLOW)
    with Tracker(localizer, settings) as tracker:
        tracker.track(picture(0), CAMERA)
        result = tracker.track(picture(9), CAMERA)
    assert result.status == "tracking", result.reason
    assert result.anchor_age == 0
    right(result, pose(9))


def test_a_frame_that_may_not_wait_leaves_the_render_to_the_next(localizer: Localizer) -> None:
    """Without the localizer."""
    settings = TrackingSettings(solver=SLOW, patience=10_000)
    with Tracker(localizer, settings) as tracker:
        assert until_found(tracker, 0).status == "relocalized"
        assert tracker.track(picture(0), CAMERA).status == "tracking"
        assert tracker.track(picture(9), CAMERA).status == "lost"
        right(until_found(tracker, 9), pose(9))


def test_anchors_do_not_pile_up(localizer: Localizer) -> None:
    settings = TrackingSettings(wait=True, anchor_pixels=1.0, farthest_pixels=1.0, anchors=2)
    there_and_back = [*range(6), *range(4, 0, -1)] * 4
    asked = set()
    with Tracker(localizer, settings) as tracker:
        for number, index in enumerate(there_and_back):
            result = tracker.track(picture(index), CAMERA)
            asked.add(number - (result.anchor_age or 0))
        gc.collect()
        alive = sum(isinstance(thing, Anchor) for thing in gc.get_objects())
    assert len(asked) > 10
    # Two that are kept, one of the last frame that was judged, one that is on its way.
    assert alive <= 4


def test_matches_end_a_wrong_pose(localizer: Localizer, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tracker's own word is not enough: here the matches speak for another place."""
    matched = localizer.match_at(picture(4), CAMERA, pose(4))
    assert matched.doubt is None and matched.coarse is not None
    elsewhere = se3.exp([0.08, 0, 0, 0, 0.05, 0]) @ pose(4)
    wrong = replace(matched, coarse=replace(matched.coarse, cam_from_world=elsewhere))
    with Tracker(localizer, TrackingSettings(trust=TrustSettings(check_frames=2))) as tracker:
        assert until_found(tracker, 4).status == "relocalized"
        with monkeypatch.context() as patch:
            patch.setattr(Localizer, "match_at", lambda *_: wrong)
            result = until_lost(tracker, 4)
        assert result.status == "lost"
        assert result.reason is not None
        assert "matches with the map contradict the pose by" in result.reason
        assert until_found(tracker, 4).status == "relocalized"


def test_matches_that_fail_again_and_again_end_it_too(
    localizer: Localizer, monkeypatch: pytest.MonkeyPatch
) -> None:
    matched = localizer.match_at(picture(4), CAMERA, pose(4))
    unsure = replace(matched, doubt="only 3 matches agree with a pose (20 needed)")
    trust = TrustSettings(check_frames=2, max_unconfirmed=1)
    with Tracker(localizer, TrackingSettings(trust=trust)) as tracker:
        until_found(tracker, 4)
        monkeypatch.setattr(Localizer, "match_at", lambda *_: unsure)
        result = until_lost(tracker, 4)
        assert result.reason is not None
        assert "do not confirm the pose (only 3 matches" in result.reason
