# SPDX-License-Identifier: Apache-2.0
"""Uneven light is recognized and fitted; even light is left alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, RayCastRenderer, room, room_camera

from gscpe.errors import SettingsError
from gscpe.geometry import pose_difference, se3
from gscpe.photos import Photo, luminance
from gscpe.refinement import (
    IlluminationSettings,
    LightSettings,
    RefinementSettings,
    refine_pose,
)
from gscpe.refinement.illumination import fit_illumination

CAMERA = room_camera(320, 240)
SETTINGS = IlluminationSettings()
EVERYWHERE = np.ones((240, 320), dtype=bool)


def place() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    y, x = np.mgrid[:240, :320] + 0.5
    return (x - 160.0) / 160.0, (y - 120.0) / 160.0


def lamp() -> NDArray[np.float32]:
    """A spot left of the middle, and a tenth of its light everywhere."""
    x, y = place()
    return np.asarray(0.1 + 0.9 * np.exp(-2.0 * ((x + 0.3) ** 2 + y**2)), dtype=np.float32)


def vignette() -> NDArray[np.float32]:
    """A third of the light in the corners."""
    x, y = place()
    return np.asarray((1.0 + 0.5 * (x**2 + y**2)) ** -2, dtype=np.float32)


def picture() -> NDArray[np.float32]:
    return luminance(room().shoot(CAMERA, ROOM_POSE).uint8)


@pytest.mark.parametrize("light", [lamp, vignette])
def test_it_is_fitted(light: object, rng: np.random.Generator) -> None:
    """To a tenth, also where a quarter of the photo shows something else, and with noise."""
    assert callable(light)
    field = light()
    photo = picture() * field + rng.normal(0.0, 0.01, field.shape).astype(np.float32)
    photo[:120, :160] = 0.4
    found = fit_illumination(picture(), photo, EVERYWHERE, SETTINGS)
    assert found is not None
    kept = EVERYWHERE.copy()
    kept[:130, :170] = False
    assert np.quantile(np.abs(np.log(found / field))[kept], 0.9) < 0.15


@pytest.mark.parametrize(("gain", "bias"), [(1.0, 0.0), (0.3, 0.0), (0.8, 0.1)])
def test_even_light_is_left_alone(gain: float, bias: float, rng: np.random.Generator) -> None:
    noise = rng.normal(0.0, 0.01, EVERYWHERE.shape).astype(np.float32)
    photo = gain * picture() + np.float32(bias) + noise
    assert fit_illumination(picture(), photo, EVERYWHERE, SETTINGS) is None


def test_too_little_to_see() -> None:
    dark = np.zeros((240, 320), dtype=np.float32)
    assert fit_illumination(picture(), dark, EVERYWHERE, SETTINGS) is None
    assert fit_illumination(picture(), picture() * lamp(), ~EVERYWHERE, SETTINGS) is None


@pytest.mark.parametrize("light", [lamp, vignette])
def test_the_alignment_is_better_for_it(light: object) -> None:
    assert callable(light)
    truth = se3.exp([0.01, -0.005, 0.008, 0.002, -0.004, 0.003]) @ ROOM_POSE
    rgb = room().shoot(CAMERA, truth, samples=2).rgb * light()[..., None]
    photo = Photo(np.rint(255 * np.clip(rgb, 0, 1)).astype(np.uint8), CAMERA)
    never = LightSettings(illumination=IlluminationSettings(least_gain=0.0))
    errors = []
    for settings in (RefinementSettings(), RefinementSettings(light=never)):
        found = refine_pose(RayCastRenderer(room()), photo, ROOM_POSE, settings)
        assert found.cam_from_world is not None
        errors.append(pose_difference(found.cam_from_world, truth).distance)
        assert 0.1 < found.gain < 1.0
    assert errors[0] < 1e-3
    assert errors[0] < 0.5 * errors[1]


def test_impossible_settings() -> None:
    with pytest.raises(SettingsError, match="degree must be a whole number, 1 to 6"):
        IlluminationSettings(degree=0)
