# SPDX-License-Identifier: Apache-2.0
"""Photos of a room in which much has been moved."""

from __future__ import annotations

from typing import Any, Callable

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import Localizer
from gscpe.geometry import pose_difference, se3
from gscpe.matching import SiftMatcher

CAMERA = room_camera(480, 360)
TRUTH = np.asarray(se3.exp([0.04, -0.03, 0.05, 0.02, -0.02, 0.01]) @ ROOM_POSE)


@pytest.mark.parametrize(("seed", "found"), [(0, False), (1, True), (2, True), (3, False)])
def test_what_has_not_been_moved_tells_the_pose(
    seed: int, found: bool, tool: Callable[[str], Any]
) -> None:
    """Three tenths of the photo moved alike, and three tenths are gone; many matches agree with a
    camera that has turned with what has moved. Where neither holds clearly more, there is none."""
    image = tool("changed_photos").rearranged(room().shoot(CAMERA, TRUTH, samples=2).uint8, seed)
    with Localizer(room_map(), matcher=SiftMatcher()) as localizer:
        result = localizer.localize(image, CAMERA)
    assert result.coarse is not None
    assert len(result.coarse.rival_pixels) > 100
    if not found:
        assert result.reason is not None and "something has been moved" in result.reason
    else:
        assert result.cam_from_world is not None, result.reason
        assert pose_difference(result.cam_from_world, TRUTH).distance < 0.01
