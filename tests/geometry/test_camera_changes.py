# SPDX-License-Identifier: Apache-2.0
"""Small changes of a camera, and how well a camera is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gscpe.errors import CameraError
from gscpe.geometry import Camera
from gscpe.geometry.intrinsics import changed_camera, moved_by_intrinsics
from gscpe.geometry.lens import image_of_directions
from gscpe.photos.orientation import numbers_turned, turned_camera

CAMERA = Camera.pinhole(640, 480, fx=520.0, fy=530.0, cx=311.0, cy=247.0)


def test_moved_pixels_are_the_derivative_of_the_camera(rng: np.random.Generator) -> None:
    slopes = rng.uniform(-0.6, 0.6, (20, 2))
    directions = np.column_stack([slopes, np.ones(20)])
    moved = moved_by_intrinsics(*slopes.T)
    for number, step in enumerate(1e-6 * np.eye(5)):
        ahead, behind = (
            image_of_directions(changed_camera(CAMERA, sign * step), directions)[0]
            for sign in (1.0, -1.0)
        )
        expected = (ahead - behind) / 2e-6 / [CAMERA.fx, CAMERA.fy]
        np.testing.assert_allclose(moved[number].T, expected, atol=1e-6)


def test_a_change_adds_to_what_the_lens_distorts() -> None:
    bent = Camera.from_colmap("OPENCV", 640, 480, [520, 530, 311, 247, -0.1, 0.02, 0.001, -0.002])
    changed = changed_camera(bent, np.array([0.0, 0.0, 0.0, 0.0, 0.03]))
    assert changed.distortion[0] == pytest.approx(-0.07)
    assert changed.distortion[1:] == bent.distortion[1:]
    assert changed_camera(CAMERA, np.zeros(5)) == CAMERA
    assert changed_camera(CAMERA, np.array([0.1, 0.0, 0.01, 0.0, 0.0])).is_pinhole


@pytest.mark.parametrize("orientation", range(1, 9))
def test_changes_turn_with_the_camera(orientation: int) -> None:
    change = np.array([0.02, 0.01, 0.005, -0.003, -0.05])
    turned = turned_camera(changed_camera(CAMERA, change), orientation)
    same = changed_camera(turned_camera(CAMERA, orientation), numbers_turned(orientation) @ change)
    for name in ("width", "height", "fx", "fy", "cx", "cy", "distortion"):
        assert getattr(turned, name) == pytest.approx(getattr(same, name))


def test_the_covariance_turns_and_is_kept(rng: np.random.Generator) -> None:
    root = 0.01 * rng.normal(size=(5, 5))
    camera = CAMERA.with_covariance(root @ root.T)
    turned = turned_camera(camera, 6)
    numbers = numbers_turned(6)
    np.testing.assert_allclose(turned.covariance_matrix(), numbers @ root @ root.T @ numbers.T)
    assert camera.resized(320, 240).covariance == camera.covariance
    assert camera.without_distortion().covariance == camera.covariance
    assert hash(camera) != hash(CAMERA)


def test_standard_deviations() -> None:
    camera = CAMERA.unsure(focal=0.02, aspect=0.003, principal=0.01, radial=0.05)
    expected = np.array([0.02, 0.003, 0.01, 0.01, 0.05]) ** 2
    np.testing.assert_allclose(camera.covariance_matrix(), np.diag(expected))
    assert camera.focal_sigma == pytest.approx(0.02)
    assert CAMERA.unsure() == CAMERA
    assert CAMERA.focal_sigma == 0.0
    assert not CAMERA.covariance_matrix().any()


@pytest.mark.parametrize("sigma", [-0.01, float("nan"), float("inf")])
def test_impossible_deviations_are_refused(sigma: float) -> None:
    with pytest.raises(CameraError, match="standard deviations must be 0 or more"):
        CAMERA.unsure(principal=sigma)


@pytest.mark.parametrize(
    "covariance",
    [
        *(np.eye(4), -np.eye(5), np.full((5, 5), np.nan), np.eye(5) + np.eye(5, k=1)),
        *(
            np.zeros(0),
            np.zeros(5),
            np.ones(5),
            1.0,
            1j * np.eye(5),
            None,
            "x",
            [[1.0], [1.0, 2.0]],
        ),
    ],
)
def test_what_is_no_covariance_is_refused(covariance: Any) -> None:
    with pytest.raises(CameraError, match="covariance must be empty or 5 rows of 5"):
        CAMERA.with_covariance(covariance)
    with pytest.raises(CameraError, match="covariance must be"):
        Camera(640, 480, 520, 520, 320, 240, covariance=((1.0, 2.0), (1.0,)))
    with pytest.raises(CameraError, match="covariance must be"):
        Camera(640, 480, 520, 520, 320, 240, covariance=covariance)


def test_deviations_that_are_no_numbers_are_refused() -> None:
    wrong: Any
    for wrong in ("x", np.ones(3), [0.1]):
        with pytest.raises(CameraError, match="standard deviations must be numbers"):
            CAMERA.unsure(focal=wrong)
    with pytest.raises(CameraError, match="standard deviations must be 0 or more"):
        CAMERA.unsure(focal=1e200)
