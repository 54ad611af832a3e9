# SPDX-License-Identifier: Apache-2.0
"""From far off: turned starts on the smallest image."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import ROOM_POSE, RayCastRenderer, room, room_camera

from gscpe.geometry import pose_difference, se3
from gscpe.photos import Photo, luminance
from gscpe.refinement import RefinementSettings, refine_pose, turned_starts
from gscpe.refinement.lucas_kanade import Alignment
from gscpe.refinement.pyramid import AnchorLevel, anchor_pyramid, photo_pyramid
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.template import build_template
from gscpe.refinement.turned_starts import align_from_turned_starts

CAMERA = room_camera(512, 384)
SHOT = room().shoot(CAMERA, ROOM_POSE)


@pytest.mark.parametrize("axis", [3, 4, 5])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_camera_turned_far_is_brought_back(axis: int, sign: int) -> None:
    """By 9 degrees, 80 pixels, or 13 about its axis."""
    turn = np.zeros(6)
    turn[axis] = sign * np.radians(13.0 if axis == 5 else 9.0)
    solver = LucasKanadeSettings()
    photo = room().shoot(CAMERA, se3.exp(turn) @ ROOM_POSE)
    valid = np.ones(SHOT.depth.shape, bool)
    anchor = anchor_pyramid(
        luminance(SHOT.rgb.astype(np.float32)), SHOT.depth, valid, CAMERA, 4, 3
    )[4]
    level = photo_pyramid(luminance(photo.rgb.astype(np.float32)), valid, CAMERA, 4)[4]
    template = build_template(anchor, solver)
    assert template is not None
    found = align_from_turned_starts(template, anchor, level, 1.0, 0.0, 5.0, solver)
    assert found is not None
    left = pose_difference(found.photo_from_anchor, se3.exp(turn))
    assert left.degrees < 1.0  # half a pixel of this level
    assert left.distance < 0.05


def test_what_hardly_overlaps_does_not_win(monkeypatch: pytest.MonkeyPatch) -> None:
    """The likeness of a sliver of the picture is chance: the best of those that overlap wins."""
    level = AnchorLevel(np.zeros((12, 16), np.float32), np.ones((12, 16), bool), CAMERA, SHOT.depth)
    template = build_template(
        AnchorLevel(luminance(SHOT.rgb.astype(np.float32)), SHOT.depth > 0, CAMERA, SHOT.depth),
        LucasKanadeSettings(),
    )
    assert template is not None
    likenesses = [(0.5, 0.9), (0.99, 0.2), (0.7, 0.8), (np.nan, 0.9), (0.6, 0.9), (0.98, 0.0)]
    ends = [Alignment(np.eye(4), 1.0, float(i), 0.0, 0, 0.0, 1, True) for i in range(6)]
    aligned, told = iter([*ends, None]), iter(likenesses)
    monkeypatch.setattr(turned_starts, "align", lambda *_: next(aligned))
    monkeypatch.setattr(turned_starts, "photometric_agreement", lambda *_: next(told))
    found = align_from_turned_starts(template, level, level, 1.0, 0.0, 5.0, LucasKanadeSettings())
    assert found is ends[2]


def test_whole_refinement_from_far_off() -> None:
    """From 12 cm and 7 degrees, where the plain one ends elsewhere."""
    start = se3.exp([-0.076, -0.015, 0.091, 0.074, -0.062, 0.075]) @ ROOM_POSE
    photo = Photo(SHOT.uint8, CAMERA, None)
    errors = []
    for degrees in (5.0, 0.0):
        settings = RefinementSettings(levels=4, turned_degrees=degrees)
        result = refine_pose(RayCastRenderer(room()), photo, start, settings)
        found = result.cam_from_world
        errors.append(np.inf if found is None else pose_difference(found, ROOM_POSE).distance)
    assert errors[0] < 1e-3
    assert errors[1] > 1e-2
