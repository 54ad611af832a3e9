# SPDX-License-Identifier: Apache-2.0
"""Matches that agree on two poses: what has been moved as a whole, and what has not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gscpe.coarse.pnp import PnPSettings, estimate_absolute_pose
from gscpe.coarse.rival import RivalSettings, better_spread, find_rival
from gscpe.errors import SettingsError
from gscpe.geometry import Camera, pose_difference, se3

CAMERA = Camera.pinhole(640, 480, fx=525, fy=525, cx=320, cy=240)
PNP, SETTINGS = PnPSettings(), RivalSettings()
STAYED = np.asarray(se3.exp([0.1, -0.05, 0.2, 0.02, -0.03, 0.01]))
MOVED = np.asarray(se3.exp([0.0, 0.0, 0.0, 0.0, 0.15, 0.0]) @ STAYED)
Points = NDArray[np.float64]


def seen(rng: np.random.Generator, pose: Points, count: int, right: float) -> tuple[Points, Points]:
    """Points of the world and their pixels, to half a pixel, in so much of the photo."""
    pixels = rng.uniform([0, 0], [right * 640, 480], (count, 2))
    depth = rng.uniform(1.0, 3.0, count)
    rays = np.column_stack([(pixels - [320, 240]) / 525, np.ones(count)])
    points = (rays * depth[:, None] - pose[:3, 3]) @ pose[:3, :3]
    return points, pixels + 0.5 * rng.normal(size=pixels.shape)


def together(*parts: tuple[Points, Points]) -> tuple[Points, Points]:
    points, pixels = (np.concatenate(each) for each in zip(*parts, strict=True))
    return points, pixels


def wrong(rng: np.random.Generator, count: int) -> tuple[Points, Points]:
    points, _ = seen(rng, STAYED, count, 1.0)
    return points, rng.uniform([0, 0], [640, 480], (count, 2))


def test_what_stayed_is_spread_over_more_of_the_photo(rng: np.random.Generator) -> None:
    """More matches are on what has been moved, in the left half."""
    matches = together(seen(rng, MOVED, 260, 0.5), seen(rng, STAYED, 160, 1.0), wrong(rng, 60))
    first = estimate_absolute_pose(*matches, CAMERA, np.eye(4), PNP)
    assert first is not None
    assert pose_difference(first.cam_from_world, MOVED).degrees < 0.1
    rival = find_rival(*matches, CAMERA, np.eye(4), first, PNP, SETTINGS)
    assert rival is not None
    assert not np.any(rival.inliers & first.inliers)
    stayed, moved = better_spread(*matches, CAMERA, first, rival, PNP)
    assert pose_difference(stayed.cam_from_world, STAYED).degrees < 0.1
    assert pose_difference(moved.cam_from_world, MOVED).degrees < 0.1
    assert stayed.inliers[260:420].mean() > 0.98
    assert moved.inliers[:260].mean() > 0.95
    assert not np.any(stayed.inliers & moved.inliers)
    again = better_spread(*matches, CAMERA, stayed, moved, PNP)
    assert again == (stayed, moved)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_chance_and_small_things_are_no_rival(share: float, rng: np.random.Generator) -> None:
    moved = seen(rng, MOVED, int(share * 300), 0.4)
    matches = together(seen(rng, STAYED, 300, 1.0), moved, wrong(rng, 300))
    first = estimate_absolute_pose(*matches, CAMERA, np.eye(4), PNP)
    assert first is not None and first.inliers.sum() > 290
    assert find_rival(*matches, CAMERA, np.eye(4), first, PNP, SETTINGS) is None


def test_what_is_far_away_contradicts_a_camera_that_is_elsewhere(rng: np.random.Generator) -> None:
    """What has been moved, 2 m away, has the camera 12 cm aside; the trees, 10 m away, that do not
    agree are then only 6 pixels off."""
    aside = np.asarray(se3.exp([0.12, 0, 0, 0, 0, 0]) @ STAYED)
    trees, pixels = seen(rng, STAYED, 240, 1.0)
    trees = ((trees @ STAYED[:3, :3].T + STAYED[:3, 3]) * 5.0 - STAYED[:3, 3]) @ STAYED[:3, :3]
    matches = together(seen(rng, aside, 320, 0.5), (trees, pixels))
    first = estimate_absolute_pose(*matches, CAMERA, np.eye(4), PNP)
    assert first is not None
    settings = RivalSettings(min_share=0.1)
    assert find_rival(*matches, CAMERA, np.eye(4), first, PNP, settings) is not None


def test_few_matches_have_no_rival(rng: np.random.Generator) -> None:
    matches = together(seen(rng, MOVED, 60, 0.5), seen(rng, STAYED, 90, 1.0))
    first = estimate_absolute_pose(*matches, CAMERA, np.eye(4), PNP)
    assert first is not None
    arguments = (*matches, CAMERA, np.eye(4), first, PNP)
    assert find_rival(*arguments, SETTINGS) is None
    assert find_rival(*arguments, RivalSettings(min_inliers=50)) is not None


def test_a_bent_map_is_no_rival(rng: np.random.Generator) -> None:
    """A third of it is 6 pixels beside where it should be."""
    bent = np.asarray(se3.exp([0, 0, 0, 0, 6 / 525, 0]) @ STAYED)
    matches = together(seen(rng, STAYED, 300, 1.0), seen(rng, bent, 150, 0.4))
    first = estimate_absolute_pose(*matches, CAMERA, np.eye(4), PNP)
    assert first is not None
    arguments = (*matches, CAMERA, np.eye(4), first, PNP)
    assert find_rival(*arguments, SETTINGS) is None
    assert find_rival(*arguments, RivalSettings(min_pixels=3.0)) is not None


def test_impossible_settings() -> None:
    with pytest.raises(SettingsError, match="min_share"):
        RivalSettings(min_share=1.5)
