# SPDX-License-Identifier: Apache-2.0
"""Dim photos are matched as if they had been lit well, overexposed ones with renders that are
clipped likewise; others are left as they are."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes import ROOM_POSE, RayCastRenderer, room, room_camera, room_map

from gscpe import Localizer
from gscpe.coarse import CoarseSettings, match_render
from gscpe.geometry import pose_difference, se3
from gscpe.localization.light import exposed_like, well_lit
from gscpe.matching import SiftMatcher
from gscpe.photos import Photo
from gscpe.refinement import ClippingSettings

CAMERA = room_camera(240, 180)
TRUTH = np.asarray(se3.exp([0.06, -0.03, 0.05, 0.02, -0.03, 0.01]) @ ROOM_POSE)


def photo(factor: float, bias: float = 0.0) -> Photo:
    image = factor * room().shoot(CAMERA, TRUTH, samples=2).uint8 + bias
    return Photo(np.rint(image).astype(np.uint8), CAMERA)


@pytest.mark.parametrize("factor", [0.5, 0.1, 0.05])
def test_dim_photos_are_brightened(factor: float) -> None:
    dim = photo(factor)
    bright = well_lit(dim)
    assert np.quantile(bright.rgb.max(axis=2), 0.98) == pytest.approx(235, abs=2)
    # Brighter stays brighter, and what was equal is equal.
    for channel in range(3):
        order = np.argsort(dim.rgb[..., channel], axis=None)
        assert np.all(np.diff(bright.rgb[..., channel].reshape(-1)[order].astype(int)) >= 0)


def test_others_are_not_touched() -> None:
    for known in (photo(1.0), photo(0.6, 90.0), Photo(np.zeros((180, 240, 3), np.uint8), CAMERA)):
        assert well_lit(known) is known
    hidden = Photo(photo(0.1).rgb, CAMERA, np.zeros((180, 240), dtype=bool))
    assert well_lit(hidden) is hidden


def test_what_is_masked_does_not_count() -> None:
    dim = photo(0.1)
    rgb, valid = dim.rgb.copy(), np.ones((180, 240), dtype=bool)
    rgb[:60], valid[:60] = 255, False
    assert well_lit(Photo(rgb, CAMERA, valid)) is not None
    np.testing.assert_allclose(
        well_lit(Photo(rgb, CAMERA, valid)).rgb[60:].mean(), well_lit(dim).rgb.mean(), rtol=0.2
    )


def test_a_twentieth_of_the_light_is_localized() -> None:
    with Localizer(room_map(), matcher="sift") as localizer:
        result = localizer.localize(photo(0.05).rgb, CAMERA)
    assert result.localized, result.reason
    assert result.cam_from_world is not None and result.aligned is not None
    error = pose_difference(result.cam_from_world, TRUTH)
    assert error.distance < 0.02 and error.degrees < 0.4
    assert 0.02 < result.aligned.gain < 0.1  # the photo is aligned as it is


def test_renders_are_exposed_like_an_overexposed_photo() -> None:
    assert exposed_like(photo(1.0), ClippingSettings()) is None
    image = np.clip(2.2 * room().shoot(CAMERA, TRUTH, samples=2).uint8.astype(float), 0, 255)
    like_photo = exposed_like(Photo(image.astype(np.uint8), CAMERA), ClippingSettings())
    assert like_photo is not None
    view = RayCastRenderer(room()).render(CAMERA, TRUTH)
    shown = like_photo(view)
    assert np.median(np.abs(shown - image / 255.0)) < 0.02
    assert np.mean(shown == 1.0) == pytest.approx(np.mean(image == 255.0), abs=0.05)


def test_edges_of_what_is_clipped_are_matched_where_they_are() -> None:
    """A blurred edge that is clipped half way up seems to lie beside where it is."""
    view = RayCastRenderer(room()).render(CAMERA, TRUTH)
    view = replace(view, rgb=np.asarray(cv2.GaussianBlur(view.rgb, (0, 0), 1.5), np.float32))
    image = Photo(np.rint(255 * np.clip(2.2 * view.rgb, 0, 1)).astype(np.uint8), CAMERA)
    matcher = SiftMatcher()
    prepared = matcher.prepare(image.rgb, None)
    apart, agree = [], []
    for like_photo in (exposed_like(image, ClippingSettings()), None):
        found = match_render(view, matcher, prepared, CAMERA, CoarseSettings(), like_photo)
        offsets = found.matches.photo_pixels - found.matches.render_pixels
        apart.append(np.sqrt(np.mean(np.minimum(np.sum(offsets**2, axis=1), 4.0))))
        agree.append(found.inliers)
    assert apart[0] < 0.5 * apart[1]
    assert agree[0] > agree[1]
