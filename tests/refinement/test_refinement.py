# SPDX-License-Identifier: Apache-2.0
"""Algorithm 2 as a whole, with an exact renderer in the splat's place."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, RayCastRenderer, room, room_camera, scaled_pose

from gscpe.errors import SettingsError
from gscpe.geometry import PoseDifference, pose_difference, se3
from gscpe.photos import Photo
from gscpe.refinement import RefinementResult, RefinementSettings, refine_pose
from gscpe.render import RenderedView

CAMERA = room_camera(240, 180)
STEP = np.array([0.03, -0.02, 0.04, 0.01, -0.02, 0.015])


def refine(
    start: NDArray[np.float64],
    *,
    rgb: NDArray[np.uint8] | None = None,
    valid: NDArray[np.bool_] | None = None,
    scale: float = 1.0,
    renderer: Any = None,
    **settings: Any,
) -> RefinementResult:
    """Refines the pose of the photo taken at ROOM_POSE."""
    if rgb is None:
        rgb = room().shoot(CAMERA, ROOM_POSE).uint8
    renderer = renderer or RayCastRenderer(room().scaled(scale))
    start = scaled_pose(start, scale)
    return refine_pose(renderer, Photo(rgb, CAMERA, valid), start, RefinementSettings(**settings))


def error_of(result: RefinementResult, scale: float = 1.0) -> PoseDifference:
    assert result.cam_from_world is not None
    assert result.reason is None
    return pose_difference(scaled_pose(result.cam_from_world, 1.0 / scale), ROOM_POSE)


def test_it_finds_the_true_pose() -> None:
    """From 5 cm and 1.5 degrees off, to a few thousandths of a pixel: the last render is all
    but the photo itself (measured: 0.016 mm and 0.0004 degrees)."""
    result = refine(se3.exp(STEP) @ ROOM_POSE)
    error = error_of(result)
    assert error.distance < 5e-5
    assert error.degrees < 1.2e-3
    assert result.converged
    assert 2 <= result.anchors <= 3
    assert result.gain == pytest.approx(1.0, abs=1e-3)
    assert result.bias == pytest.approx(0.0, abs=1e-3)
    assert result.residual < 0.005
    assert result.agreement > 0.9
    assert result.overlap > 0.9


def test_light_and_noise(rng: np.random.Generator) -> None:
    shot = room().shoot(CAMERA, ROOM_POSE)
    dim = 0.7 * shot.rgb + 0.1 + 0.02 * rng.normal(size=shot.rgb.shape)
    result = refine(
        se3.exp(STEP) @ ROOM_POSE, rgb=np.rint(255 * np.clip(dim, 0, 1)).astype(np.uint8)
    )
    error = error_of(result)
    assert error.distance < 1e-3
    assert error.degrees < 0.02
    assert result.gain == pytest.approx(0.7, abs=0.02)
    assert result.bias == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize("scale", [0.3, 10.0])
def test_it_works_in_rooms_of_other_sizes(scale: float) -> None:
    start = se3.exp(STEP) @ ROOM_POSE
    usual, other = refine(start), refine(start, scale=scale)
    assert error_of(other, scale).distance < 5e-5
    assert other.pixels == pytest.approx(usual.pixels, rel=0.05)
    assert usual.covariance is not None
    assert other.covariance is not None
    unscale = np.array([1 / scale] * 3 + [1] * 3)
    ratio = np.diag(other.covariance) * unscale**2 / np.diag(usual.covariance)
    np.testing.assert_allclose(ratio, 1.0, rtol=0.15)


def test_tolerances_follow_the_depth() -> None:
    """They are made for surfaces between half a metre and two metres away."""
    usual = refine(ROOM_POSE, scale=0.8)
    assert usual.tolerance_unit == 1.0
    far, farther = (refine(ROOM_POSE, scale=scale) for scale in (10.0, 20.0))
    assert far.tolerance_unit < 0.2
    assert farther.tolerance_unit == pytest.approx(0.5 * far.tolerance_unit, rel=1e-3)
    close = refine(ROOM_POSE, scale=0.05)
    assert close.tolerance_unit > 2.0


PAPER: dict[str, Any] = {"rerender_translation": 0.005, "rerender_rotation_degrees": 0.5}


def test_it_renders_anew_when_the_image_has_moved() -> None:
    """8 mm at 2 m are a pixel of this camera; 2 mm are not."""
    assert refine(ROOM_POSE).anchors == 1
    shifted = se3.exp([0.016, 0, 0, 0, 0, 0]) @ ROOM_POSE
    assert refine(shifted).anchors == 2
    assert refine(shifted, rerender_pixels=10.0).anchors == 1
    assert refine(se3.exp([0.002, 0, 0, 0, 0, 0]) @ ROOM_POSE).anchors == 1
    assert refine(shifted, max_anchors=1).anchors == 1
    assert refine(ROOM_POSE, min_anchors=3).anchors == 3
    for scale in (0.1, 10.0):  # the image moves alike, however large the room is
        assert refine(shifted, scale=scale).anchors == 2


def test_the_papers_criterion() -> None:
    """5 mm or half a degree from the anchor; either is enough."""
    shifted = se3.exp([0.008, 0, 0, 0, 0, 0]) @ ROOM_POSE
    turned = se3.exp([0, 0, 0, 0, np.radians(0.8), 0]) @ ROOM_POSE
    assert refine(ROOM_POSE, **PAPER).anchors == 1
    assert refine(shifted, **PAPER).anchors == 2
    assert refine(turned, **PAPER).anchors == 2
    assert refine(turned, **PAPER | {"rerender_rotation_degrees": 1.0}).anchors == 1
    assert refine(shifted, **PAPER | {"rerender_translation": 0.01}).anchors == 1


@pytest.mark.parametrize("levels", [0, 1, 2, 3, 12])
def test_any_number_of_levels(levels: int) -> None:
    """From 12 cm and 6 degrees off. Twelve times halved there is no photo left: as many
    levels as there are do."""
    far = se3.exp([0.09, -0.06, 0.06, 0.05, -0.06, 0.06]) @ ROOM_POSE
    assert error_of(refine(far, levels=levels)).distance < 1e-4


def test_invalid_pixels_of_the_photo_do_not_count() -> None:
    rgb = room().shoot(CAMERA, ROOM_POSE).uint8.copy()
    valid = np.ones(rgb.shape[:2], dtype=bool)
    valid[:, 160:] = False
    rgb[:, 160:] = 255
    result = refine(se3.exp(STEP) @ ROOM_POSE, rgb=rgb, valid=valid)
    assert error_of(result).distance < 1e-4
    assert result.overlap == pytest.approx(160 / 240, abs=0.06)


class Nothing(RayCastRenderer):
    """Looks past the map."""

    def render(self, camera: Any, cam_from_world: NDArray[np.float64]) -> RenderedView:
        view = super().render(camera, cam_from_world)
        return replace(view, opacity=np.zeros_like(view.opacity), depth=np.zeros_like(view.depth))


def test_where_the_map_shows_nothing() -> None:
    result = refine(ROOM_POSE, renderer=Nothing(room()))
    assert result.cam_from_world is None
    assert result.covariance is None
    assert result.reason == "too little of the map is visible around the pose that it starts from"


@pytest.mark.parametrize("name", ["black", "white", "grey", "noise", "another place"])
def test_pictures_of_no_place_are_not_trusted(name: str, rng: np.random.Generator) -> None:
    """No pose at all, or one whose render does not look like the picture."""
    shape = (CAMERA.height, CAMERA.width, 3)
    pictures = {
        "black": np.zeros(shape, np.uint8),
        "white": np.full(shape, 255, np.uint8),
        "grey": np.full(shape, 120, np.uint8),
        "noise": rng.integers(0, 256, shape, dtype=np.uint8),
        "another place": room(77).shoot(CAMERA, ROOM_POSE).uint8,
    }
    result = refine(ROOM_POSE, rgb=pictures[name])
    if result.cam_from_world is None:
        assert result.reason
    else:
        assert not result.agreement >= 0.3


@pytest.mark.parametrize(
    "settings", [{"levels": -1}, {"min_anchors": 0}, {"min_anchors": 3, "max_anchors": 2}]
)
def test_impossible_settings(settings: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(settings))):
        RefinementSettings(**settings)
