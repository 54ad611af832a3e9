# SPDX-License-Identifier: Apache-2.0
"""The SIFT matcher on ray-cast pictures, where every match can be checked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera

from gscpe.coarse.lift import lift
from gscpe.errors import SettingsError
from gscpe.geometry import se3
from gscpe.geometry.projection import project, transform_points
from gscpe.matching import Matches, SiftMatcher, SiftMatcherSettings
from gscpe.render import RenderedView

CAMERA = room_camera(240, 180)


def picture(
    shift: tuple[float, float] = (0.0, 0.0), step: NDArray[np.float64] | None = None
) -> NDArray[np.uint8]:
    """The room, the picture shifted by the principal point or the camera moved."""
    camera = replace(CAMERA, cx=CAMERA.cx + shift[0], cy=CAMERA.cy + shift[1])
    pose = ROOM_POSE if step is None else se3.exp(step) @ ROOM_POSE
    return room().shoot(camera, pose).uint8


def match(photo: NDArray[np.uint8], render: NDArray[np.uint8]) -> Matches:
    matcher = SiftMatcher()
    return matcher.match(matcher.prepare(photo, None), matcher.prepare(render, None))


@pytest.mark.parametrize("shift", [(0.0, 0.0), (7.0, -4.0), (5.3, 2.8), (-3.5, 6.25)])
def test_shifts_are_measured_without_bias(shift: tuple[float, float]) -> None:
    """OpenCV's SIFT without precise upscaling would be off by a quarter of a pixel."""
    matches = match(picture(shift), picture())
    assert len(matches) > 150
    moved = matches.photo_pixels - matches.render_pixels
    np.testing.assert_allclose(np.median(moved, axis=0), shift, atol=0.05)


def test_pixel_centres_are_at_a_half() -> None:
    """The projected texture itself says where a point is: a picture twice as large of the
    same view has every match at twice the coordinates, which holds for no other origin."""
    large = room().shoot(CAMERA.resized(480, 360), ROOM_POSE).uint8
    matches = match(large, picture())
    assert len(matches) > 100
    offset = np.median(matches.photo_pixels - 2.0 * matches.render_pixels, axis=0)
    np.testing.assert_allclose(offset, [0.0, 0.0], atol=0.1)  # half a pixel here without + 0.5


def test_matches_across_a_moved_camera_are_right() -> None:
    step = np.array([0.08, -0.05, 0.06, 0.02, -0.05, 0.08])
    matches = match(picture(step=step), picture())
    shot = room().shoot(CAMERA, ROOM_POSE)
    view = RenderedView(
        shot.rgb.astype(np.float32),
        np.ones_like(shot.depth),
        shot.depth,
        np.zeros_like(shot.depth),
        CAMERA,
        ROOM_POSE,
    )
    points, _ = lift(view, matches.render_pixels)
    expected = project(CAMERA, transform_points(se3.exp(step) @ ROOM_POSE, points))
    errors = np.linalg.norm(matches.photo_pixels - expected, axis=1)
    assert len(matches) > 100
    assert np.mean(errors < 2.0) > 0.85
    assert np.median(errors) < 0.3
    bias = np.median((matches.photo_pixels - expected)[errors < 2.0], axis=0)
    np.testing.assert_allclose(bias, [0, 0], atol=0.1)


def test_invalid_places_are_left_out() -> None:
    valid = np.ones((CAMERA.height, CAMERA.width), dtype=bool)
    valid[:, 120:] = False
    matcher = SiftMatcher()
    prepared = matcher.prepare(picture(), valid)
    assert 50 < len(prepared.features) < len(matcher.prepare(picture(), None).features)
    assert prepared.features.pixels[:, 0].max() <= 121.0
    matches = matcher.match(prepared, matcher.prepare(picture(), None))
    assert matches.photo_pixels[:, 0].max() <= 121.0
    assert len(matcher.prepare(picture(), np.zeros_like(valid)).features) == 0


def test_matches_are_one_to_one_and_scored() -> None:
    matches = match(picture((2.5, 0.0)), picture())
    assert matches.photo_pixels.shape == matches.render_pixels.shape == (len(matches), 2)
    assert matches.photo_pixels.dtype == matches.render_pixels.dtype == np.float64
    assert matches.scores.dtype == np.float32
    assert np.all((matches.scores > 0.15 - 1e-6) & (matches.scores <= 1.0))  # ratio below 0.85
    stricter = SiftMatcher(SiftMatcherSettings(ratio=0.5))
    features = [stricter.prepare(image, None) for image in (picture((2.5, 0.0)), picture())]
    assert 0 < len(stricter.match(*features)) < len(matches)


def test_empty_pictures_match_nothing() -> None:
    blank = np.full((180, 240, 3), 90, np.uint8)
    for photo, render in ((blank, picture()), (picture(), blank), (blank, blank)):
        matches = match(photo, render)
        assert len(matches) == 0
        assert matches.photo_pixels.shape == matches.render_pixels.shape == (0, 2)


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (8, 8)])
def test_tiny_pictures(size: tuple[int, int], rng: np.random.Generator) -> None:
    tiny = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
    assert len(match(tiny, picture())) < 10


def test_other_places_hardly_match() -> None:
    other = room(77).shoot(CAMERA, ROOM_POSE).uint8
    assert len(match(other, picture())) < 0.1 * len(match(picture((2.5, 0.0)), picture()))


@pytest.mark.parametrize("ratio", [0.0, -1.0, 1.1])
def test_impossible_ratios(ratio: float) -> None:
    with pytest.raises(SettingsError, match="ratio must be"):
        SiftMatcherSettings(ratio=ratio)
