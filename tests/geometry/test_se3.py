# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms, their tangent vectors, and the difference of poses."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import numeric_jacobian, random_pose, random_rotation
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.linalg import expm

from gscpe.errors import PoseError
from gscpe.geometry import pose_difference
from gscpe.geometry.pose_error import camera_centre, rotation_angle_degrees
from gscpe.geometry.se3 import (
    adjoint,
    check_transform,
    exp,
    from_quaternion_translation,
    from_rotation_translation,
    inverse,
    log,
    skew,
    to_quaternion_translation,
)

Vector = NDArray[np.float64]
# |rotation| stays under pi, where the logarithm is unique.
translations = arrays(np.float64, 3, elements=st.floats(-100.0, 100.0))
rotation_vectors = arrays(np.float64, 3, elements=st.floats(-1.8, 1.8))


def twist(xi: Vector) -> NDArray[np.float64]:
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = skew(xi[3:])
    matrix[:3, 3] = xi[:3]
    return matrix


@given(translations, rotation_vectors)
def test_log_undoes_exp(translation: Vector, rotation: Vector) -> None:
    xi = np.concatenate([translation, rotation])
    np.testing.assert_allclose(log(exp(xi)), xi, atol=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_exp_undoes_log_for_any_rotation(seed: int) -> None:
    pose = random_pose(np.random.default_rng(seed))
    np.testing.assert_allclose(exp(log(pose)), pose, atol=1e-9)


@pytest.mark.parametrize("axis", np.eye(3))
def test_exp_undoes_log_at_half_a_turn(axis: Vector) -> None:
    pose = exp(np.concatenate([[1.0, -2.0, 3.0], np.pi * axis]))
    np.testing.assert_allclose(exp(log(pose)), pose, atol=1e-9)


@given(translations, rotation_vectors)
def test_exp_is_the_matrix_exponential(translation: Vector, rotation: Vector) -> None:
    xi = np.concatenate([translation, rotation])
    np.testing.assert_allclose(exp(xi), expm(twist(xi)), rtol=0, atol=1e-10)


@pytest.mark.parametrize("angle", [1e-9, 1e-6, 3e-5, 0.99e-4, 1.01e-4, 1e-3, 1e-2, 0.1])
def test_small_angles_keep_all_digits(angle: float, rng: np.random.Generator) -> None:
    axis = rng.normal(size=3)
    xi = np.concatenate([rng.uniform(-10, 10, 3), angle * axis / np.linalg.norm(axis)])
    np.testing.assert_allclose(exp(xi), expm(twist(xi)), rtol=0, atol=1e-11)
    np.testing.assert_allclose(log(exp(xi)), xi, rtol=0, atol=1e-11)


def test_exp_at_zero_is_the_identity() -> None:
    np.testing.assert_array_equal(exp(np.zeros(6)), np.eye(4))
    np.testing.assert_array_equal(log(np.eye(4)), np.zeros(6))


def test_derivative_of_exp_at_zero_is_the_generators() -> None:
    derivative = numeric_jacobian(exp, np.zeros(6))
    expected = np.stack([twist(e) for e in np.eye(6)], axis=-1)
    np.testing.assert_allclose(derivative, expected, atol=1e-9)


def test_the_tangent_vector_is_translation_then_rotation() -> None:
    np.testing.assert_allclose(exp([1, 2, 3, 0, 0, 0])[:3, 3], [1, 2, 3])
    quarter = exp([0, 0, 0, 0, 0, np.pi / 2])
    np.testing.assert_allclose(quarter[:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@given(st.integers(0, 2**32 - 1))
def test_inverse(seed: int) -> None:
    pose = random_pose(np.random.default_rng(seed))
    np.testing.assert_allclose(inverse(pose) @ pose, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(inverse(pose), np.linalg.inv(pose), atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_the_adjoint_moves_a_tangent_vector_across(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose, xi = random_pose(rng), rng.normal(size=6)
    np.testing.assert_allclose(pose @ exp(xi), exp(adjoint(pose) @ xi) @ pose, atol=1e-9)


@given(translations, translations)
def test_skew_is_the_cross_product(a: Vector, b: Vector) -> None:
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-9)
    np.testing.assert_array_equal(skew(a), -skew(a).T)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10.0))
def test_quaternion_round_trip(seed: int, length: float) -> None:
    pose = random_pose(np.random.default_rng(seed))
    quaternion, translation = to_quaternion_translation(pose)
    assert quaternion[0] >= 0
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-12)
    for sign in (1.0, -1.0):
        again = from_quaternion_translation(sign * length * quaternion, translation)
        np.testing.assert_allclose(again, pose, atol=1e-12)


def test_quaternions_are_scalar_first() -> None:
    half = np.sqrt(0.5)
    quarter_about_x = from_quaternion_translation([half, half, 0, 0], [0, 0, 0])
    np.testing.assert_allclose(quarter_about_x[:3, :3] @ [0, 1, 0], [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("quaternion", "translation", "message"),
    [
        ([0, 0, 0, 0], [0, 0, 0], "length zero"),
        ([np.nan, 0, 0, 0], [0, 0, 0], "not finite"),
        ([1, 0, 0, 0], [np.inf, 0, 0], "not finite"),
    ],
)
def test_impossible_quaternions(quaternion: Vector, translation: Vector, message: str) -> None:
    with pytest.raises(PoseError, match=message):
        from_quaternion_translation(quaternion, translation)


def test_check_transform_accepts_rigid_transforms(rng: np.random.Generator) -> None:
    pose = random_pose(rng)
    np.testing.assert_array_equal(check_transform(pose, "a"), pose)
    rounded = check_transform(pose.astype(np.float32).tolist(), "a")
    assert rounded.dtype == np.float64


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.eye(3), r"4x4 matrix, not an array of shape \(3, 3\)"),
        (np.full((4, 4), np.nan), "not finite"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "not a rigid"),  # a mirror
        (np.diag([1.0, 1.01, 1.0, 1.0]), "not a rigid"),  # a stretch
        (np.diag([2.0, 2.0, 2.0, 1.0]), "not a rigid"),  # a similarity
        (np.diag([1.0, 1.0, 1.0, 2.0]), "not a rigid"),  # a wrong last row
        (np.zeros((4, 4)), "not a rigid"),
        (None, "4x4 matrix"),
    ],
)
def test_check_transform_names_what_is_wrong(bad: object, message: str) -> None:
    with pytest.raises(PoseError, match=message) as caught:
        check_transform(bad, "cam_from_world of a.jpg")  # type: ignore[arg-type]
    assert "cam_from_world of a.jpg" in str(caught.value)


@pytest.mark.parametrize("bad", ["identity", [[1, 2], [3]], [["a"] * 4] * 4])
def test_check_transform_of_what_is_no_matrix(bad: object) -> None:
    with pytest.raises(PoseError):
        check_transform(bad, "cam_from_world")  # type: ignore[arg-type]


@given(st.integers(0, 2**32 - 1))
def test_pose_difference_is_symmetric_and_zero_on_itself(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_pose(rng), random_pose(rng)
    forth, back = pose_difference(a, b), pose_difference(b, a)
    assert forth.distance == pytest.approx(back.distance, abs=1e-12)
    assert forth.degrees == pytest.approx(back.degrees, abs=1e-9)
    same = pose_difference(a, a)
    assert same.distance == 0.0
    assert same.degrees == pytest.approx(0.0, abs=1e-12)


def test_the_distance_is_between_camera_centres(rng: np.random.Generator) -> None:
    rotation_a, rotation_b = random_rotation(rng), random_rotation(rng)
    centre_a, centre_b = np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 7.5])
    a = from_rotation_translation(rotation_a, -rotation_a @ centre_a)
    b = from_rotation_translation(rotation_b, -rotation_b @ centre_b)
    np.testing.assert_allclose(camera_centre(a), centre_a, atol=1e-12)
    assert pose_difference(a, b).distance == pytest.approx(4.5, abs=1e-12)


@pytest.mark.parametrize("degrees", [1e-6, 1e-3, 0.29, 45.0, 90.0, 179.0, 179.9999])
def test_angles_are_exact(degrees: float, rng: np.random.Generator) -> None:
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    a = random_pose(rng)
    b = exp(np.concatenate([np.zeros(3), np.radians(degrees) * axis])) @ a
    assert pose_difference(a, b).degrees == pytest.approx(degrees, rel=1e-7)


def test_half_a_turn_is_180_degrees() -> None:
    assert rotation_angle_degrees(np.diag([1.0, -1.0, -1.0])) == pytest.approx(180.0, abs=1e-5)
