# SPDX-License-Identifier: Apache-2.0
"""Photos whose brightest parts are clipped."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, RayCastRenderer, room, room_camera

from gscpe.errors import SettingsError
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.photos import Photo
from gscpe.refinement import RefinementResult, RefinementSettings, refine_pose
from gscpe.refinement import light as refinement_light
from gscpe.refinement import loop as refinement_loop
from gscpe.refinement.exposure import (
    ClippingSettings,
    clipped_share,
    darker_channels,
    expose,
    fit_exposure,
    is_clipped,
    without_flat_white,
)
from gscpe.refinement.pyramid import AnchorLevel
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.template import build_template
from gscpe.render import RenderedView

CAMERA = room_camera(240, 180)
CLIPPING = ClippingSettings()
SHOT = room().shoot(CAMERA, ROOM_POSE)
RENDER = SHOT.rgb.astype(np.float32)
SHOWN = np.ones(SHOT.depth.shape, dtype=bool)


def taken(gain: float, bias: float = 0.0) -> NDArray[np.uint8]:
    return np.rint(255 * np.clip(gain * SHOT.rgb + bias, 0, 1)).astype(np.uint8)


def test_what_is_clipped() -> None:
    assert not is_clipped(taken(1.0), CLIPPING)
    assert is_clipped(taken(2.0), CLIPPING)


def test_bright_is_not_clipped_and_jpeg_hides_no_clipping() -> None:
    """A wall in the sun that stays just below white is a picture like any other; and what a JPEG
    makes of clipped pixels, 254 here and there, is still clipped."""
    assert not is_clipped(np.full((60, 80, 3), 253, np.uint8), CLIPPING)
    _, stored = cv2.imencode(".jpg", taken(2.0)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
    opened = cv2.imdecode(stored, cv2.IMREAD_COLOR)
    assert opened is not None
    assert is_clipped(np.asarray(opened[..., ::-1], np.uint8), CLIPPING)


def test_a_bright_picture_keeps_its_exposure() -> None:
    """All of it between 240 and 253: nothing is clipped, so gain and bias are determined."""
    photo = np.rint(240 + 13 * np.clip(SHOT.rgb, 0, 1)).astype(np.uint8)
    found = fit_exposure(RENDER, photo, SHOWN, CLIPPING)
    assert found is not None
    assert found[0] == pytest.approx(13 / 255, rel=0.1)
    assert found[1] == pytest.approx(240 / 255, abs=0.005)


def test_a_few_clipped_pixels_are_ordinary() -> None:
    """A lamp in the picture: a percent is not, three percent are."""
    photo = np.full((100, 100, 3), 128, np.uint8)
    photo[:10, :10, 1] = 255
    assert not is_clipped(photo, CLIPPING)
    photo[:10, :30, 1] = 255
    assert is_clipped(photo, CLIPPING)


@pytest.mark.parametrize(("gain", "bias"), [(0.6, 0.1), (1.0, 0.0), (1.6, -0.05), (2.5, 0.0)])
def test_exposure_is_found_whatever_is_clipped(gain: float, bias: float) -> None:
    photo = taken(gain, bias)
    found = fit_exposure(RENDER, photo, SHOWN, CLIPPING)
    assert found is not None
    # Means of blocks that are clipped in part are a little darker.
    assert found[0] == pytest.approx(gain, rel=0.08)
    assert found[1] == pytest.approx(bias, abs=0.04)
    exposed = expose(RENDER, gain, bias)
    np.testing.assert_allclose(exposed, photo / 255.0, atol=0.5 / 255 + 1e-6)


def test_no_exposure_without_a_picture() -> None:
    assert fit_exposure(RENDER, taken(1.0), ~SHOWN, CLIPPING) is None


def test_a_clipped_photo_is_aligned(monkeypatch: pytest.MonkeyPatch) -> None:
    photo = taken(1.9)
    start = se3.exp([0.02, -0.015, 0.02, 0.008, -0.01, 0.01]) @ ROOM_POSE

    def refine() -> RefinementResult:
        renderer = RayCastRenderer(room())
        return refine_pose(renderer, Photo(photo, CAMERA, None), start, RefinementSettings())

    result = refine()
    assert result.cam_from_world is not None
    assert result.gain == pytest.approx(1.9, rel=0.06)
    error = pose_difference(result.cam_from_world, ROOM_POSE)
    assert error.distance < 1e-3
    monkeypatch.setattr(refinement_light, "is_clipped", lambda *_: False)
    plain = refine()
    if plain.cam_from_world is not None:
        assert pose_difference(plain.cam_from_world, ROOM_POSE).distance > 2 * error.distance


def test_noise_does_not_darken_the_exposure(rng: np.random.Generator) -> None:
    """Of blocks near white, those that happen to be dark are clipped less often."""
    noise = 0.06 * cv2.resize(
        rng.normal(size=(24, 32, 3)), (240, 180), interpolation=cv2.INTER_NEAREST
    )
    photo = np.rint(255 * np.clip(1.9 * SHOT.rgb + noise, 0, 1)).astype(np.uint8)
    found = fit_exposure(RENDER, photo, SHOWN, CLIPPING)
    assert found is not None
    assert found[0] == pytest.approx(1.9, rel=0.04)
    assert found[1] == pytest.approx(0.0, abs=0.02)


def test_only_what_is_white_all_around_is_left_out() -> None:
    """Every pixel with a gradient stays, and a row of those without any beside it."""
    image = np.ones((40, 60), dtype=np.float32)
    image[:, :20] = np.linspace(0.0, 0.9, 20, dtype=np.float32)
    depth = np.full_like(image, 2.0)
    camera = room_camera(60, 40)
    level = AnchorLevel(image, np.ones(image.shape, dtype=bool), camera, depth)
    kept = without_flat_white(level)
    np.testing.assert_array_equal(kept.valid[20], np.arange(60) < 22)
    solver = LucasKanadeSettings()
    before, after = build_template(level, solver), build_template(kept, solver)
    assert before is not None and after is not None
    steep, still_steep = (np.any(t.jacobian != 0, axis=1).sum() for t in (before, after))
    assert steep == still_steep > 0
    assert len(after.intensities) < 0.6 * len(before.intensities)


def test_what_is_white_in_both_does_not_make_it_sure(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """Its residuals are zero: with them, those that say something would seem to be outliers."""
    noise = 0.04 * rng.normal(size=SHOT.rgb.shape)
    photo = np.rint(255 * np.clip(2.2 * SHOT.rgb + noise, 0, 1)).astype(np.uint8)
    assert np.mean(photo.min(axis=2) == 255) > 0.4

    def residual() -> float:
        renderer = RayCastRenderer(room())
        return refine_pose(renderer, Photo(photo, CAMERA), ROOM_POSE, RefinementSettings()).residual

    without = residual()
    monkeypatch.setattr(refinement_loop, "without_flat_white", lambda level: level)
    assert without > 0.01
    assert without > 2 * residual()


def test_darker_channels_are_white_only_where_all_are() -> None:
    pixels = np.array([[[1, 1, 1], [1, 1, 0.4], [0.3, 0.3, 0.3], [0, 0, 0]]], dtype=np.float32)
    white, red, grey, black = darker_channels(pixels)[0]
    np.testing.assert_allclose([white, grey, black], [1.0, 0.3, 0.0], atol=1e-6)
    assert 0.4 < red < np.mean([1, 1, 0.4])
    # Of what the third channel shows there, most is seen; of luminance, a ninth.
    brighter = darker_channels(pixels + np.array([0, 0, 0.01], dtype=np.float32))[0, 1]
    assert 0.8 < (brighter - red) / 0.01 < 1.0


def test_darker_channels_of_bytes() -> None:
    image = taken(1.5)
    expected = darker_channels(image.astype(np.float32) / np.float32(255.0))
    np.testing.assert_allclose(darker_channels(image), expected, atol=1e-5)


def test_channels_that_are_not_clipped_tell_the_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    """In yellow light, red and green are clipped nearly everywhere, and blue is not."""
    yellow = np.array([1.0, 1.0, 0.3], dtype=np.float32)
    picture = np.clip(6.0 * yellow * SHOT.rgb, 0, 1)
    assert np.mean(picture[..., :2] == 1) > 0.9
    assert np.mean(picture[..., 2] == 1) < 0.5

    class Yellow(RayCastRenderer):
        def render(self, camera: Camera, cam_from_world: NDArray[np.float64]) -> RenderedView:
            view = super().render(camera, cam_from_world)
            return replace(view, rgb=yellow * view.rgb)

    def error(seed: int) -> float:
        noise = 0.03 * np.random.default_rng(seed).normal(size=picture.shape)
        photo = Photo(np.rint(255 * np.clip(picture + noise, 0, 1)).astype(np.uint8), CAMERA)
        found = refine_pose(Yellow(room()), photo, ROOM_POSE, RefinementSettings())
        assert found.cam_from_world is not None
        return pose_difference(found.cam_from_world, ROOM_POSE).distance

    by_darker = np.mean([error(seed) for seed in range(4)])
    monkeypatch.setattr(refinement_light, "is_overexposed", lambda *_: False)
    by_luminance = np.mean([error(seed) for seed in range(4)])
    assert by_darker < 0.8 * by_luminance, (by_darker, by_luminance)


def test_shares_and_impossible_settings() -> None:
    photo = np.zeros((40, 40, 3), np.uint8)
    photo[:10, :, 2] = 255
    assert clipped_share(photo, CLIPPING) == 0.25
    with pytest.raises(SettingsError, match="min_share_matched"):
        ClippingSettings(min_share=0.3)
