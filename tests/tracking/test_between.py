# SPDX-License-Identifier: Apache-2.0
"""A frame between two anchors is aligned with both."""

from __future__ import annotations

from dataclasses import replace
from typing import Iterator

import numpy as np
import pytest
from moving_camera import CAMERA, picture, pose, the_map
from numpy.typing import NDArray

from gscpe import Camera, Renderer, TrackingSettings, pose_difference
from gscpe.geometry import se3
from gscpe.render import RenderedView
from gscpe.tracking.anchors import Anchor, make_anchor
from gscpe.tracking.between import aligned_between
from gscpe.tracking.follow import Followed, follow
from gscpe.tracking.frames import Frame, FrameMaker
from gscpe.tracking.motion import MotionState

SETTINGS = TrackingSettings(anchor_pixels=3.0)


class TooDeep:
    """Renders whose depth is 6% off, as a map's may be."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer

    def render(self, camera: Camera, cam_from_world: NDArray[np.float64]) -> RenderedView:
        view = self._renderer.render(camera, cam_from_world)
        return replace(view, depth=view.depth * np.float32(1.06))


@pytest.fixture(scope="module")
def renders() -> Iterator[TooDeep]:
    with Renderer(the_map().scene) as renderer:
        yield TooDeep(renderer)


def anchor_at(renders: TooDeep, index: float) -> Anchor:
    anchor = make_anchor(renders, CAMERA, pose(index), SETTINGS, 1.0, 0)
    assert anchor is not None
    return anchor


def followed_at(index: int, anchor: Anchor) -> tuple[Followed, Frame]:
    maker = FrameMaker(lambda camera: 1.0, SETTINGS.levels)
    frame = maker.frame(picture(index), CAMERA, index, float(index), None)
    expected = MotionState.at_rest(pose(index - 1), index - 1.0).predicted(float(index))
    followed = follow(frame, anchor, expected, (1.0, 0.0), SETTINGS)
    assert isinstance(followed, Followed), followed
    return followed, frame


def test_errors_of_depth_cancel_between_two_anchors(renders: TooDeep) -> None:
    errors = []
    for index in (3, 5, 7):
        behind, ahead = anchor_at(renders, index - 3.0), anchor_at(renders, index + 3.5)
        one, frame = followed_at(index, behind)
        both = aligned_between(one, frame, [behind, ahead], SETTINGS)
        assert both.anchor is behind
        errors.append(
            [pose_difference(each.cam_from_world, pose(index)).distance for each in (one, both)]
        )
    with_one, with_both = np.mean(errors, axis=0)
    assert with_both < 0.5 * with_one
    rotation = both.cam_from_world[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


def test_another_anchor_counts_only_where_it_adds_something(renders: TooDeep) -> None:
    near, far = anchor_at(renders, 2.5), anchor_at(renders, 8.0)
    beside, frame = followed_at(3, near)
    assert aligned_between(beside, frame, [near, far], SETTINGS) is beside
    behind = anchor_at(renders, 0.0)
    one, frame = followed_at(3, behind)
    assert aligned_between(one, frame, [behind], SETTINGS) is one
    too_far = anchor_at(renders, 25.0)
    assert aligned_between(one, frame, [behind, too_far], SETTINGS) is one


def test_an_anchor_that_disagrees_does_not_count(renders: TooDeep) -> None:
    """It claims to have been rendered elsewhere, a few pixels off."""
    behind, ahead = anchor_at(renders, 0.0), anchor_at(renders, 6.0)
    one, frame = followed_at(3, behind)
    assert aligned_between(one, frame, [behind, ahead], SETTINGS) is not one
    moved = se3.exp([0.05, 0.0, 0.0, 0.0, 0.0, 0.0]) @ ahead.cam_from_world
    wrong = replace(ahead, cam_from_world=moved)
    assert aligned_between(one, frame, [behind, wrong], SETTINGS) is one
