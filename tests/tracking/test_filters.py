# SPDX-License-Identifier: Apache-2.0
"""The recipes of docs/tracking.md, against samples: the code is taken from the page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gscpe import TrackingResult
from gscpe.geometry import se3

PAGE = Path(__file__).resolve().parents[2] / "docs" / "tracking.md"
_SAMPLES = 10_000


@pytest.fixture(scope="module")
def recipes() -> dict[str, Any]:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, Any] = {"np": np}
    for block in blocks:
        if block.startswith("def "):
            exec(block, names)
    return names


def a_result() -> TrackingResult:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6)) * np.repeat([0.004, 0.002], 3)[:, None]
    return TrackingResult("tracking", None, random_pose(rng), root @ root.T, 0, 1.0, 1.0)


def samples(result: TrackingResult) -> NDArray[np.float64]:
    """True camera poses in the world, (N, 4, 4), as the definition has them."""
    rng = np.random.default_rng(4)
    assert result.covariance is not None and result.cam_from_world is not None
    xi = rng.multivariate_normal(np.zeros(6), result.covariance, size=_SAMPLES)
    return np.stack([se3.inverse(se3.exp(x) @ result.cam_from_world) for x in xi])


def gtsam_local(pose: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """GTSAM: ``pose.localCoordinates(other) = Logmap(pose^-1 other)``, rotation first."""
    xi = np.stack([se3.log(se3.inverse(pose) @ other) for other in others])
    return np.concatenate([xi[:, 3:], xi[:, :3]], axis=1)


def ros_local(pose: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """REP 103: position, then rotation about the fixed axes of the frame."""
    turned = Rotation.from_matrix(others[:, :3, :3] @ pose[:3, :3].T).as_rotvec()
    return np.concatenate([others[:, :3, 3] - pose[:3, 3], turned], axis=1)


def assert_like(covariance: NDArray[np.float64], local: NDArray[np.float64]) -> None:
    """In units of the deviations; a sample of 10,000 determines them to 1.4%."""
    scale = np.sqrt(np.diag(covariance))
    sampled = np.cov(local.T) / np.outer(scale, scale)
    np.testing.assert_allclose(sampled, covariance / np.outer(scale, scale), atol=0.06)


@pytest.mark.parametrize(("name", "local"), [("gtsam", gtsam_local), ("ros", ros_local)])
def test_of_the_camera(
    recipes: dict[str, Any], name: str, local: Callable[..., NDArray[np.float64]]
) -> None:
    result = a_result()
    pose, covariance = recipes[f"{name}_pose_and_covariance"](result)
    np.testing.assert_allclose(pose, se3.inverse(np.asarray(result.cam_from_world)), atol=1e-12)
    assert_like(covariance, local(pose, samples(result)))


@pytest.mark.parametrize(("name", "local"), [("gtsam", gtsam_local), ("ros", ros_local)])
def test_of_a_body_that_carries_it(
    recipes: dict[str, Any], name: str, local: Callable[..., NDArray[np.float64]]
) -> None:
    """With the camera 0.4 m away, turned by more than a right angle."""
    result = a_result()
    cam_from_body = se3.exp([0.1, 0.3, -0.25, 1.2, -1.0, 0.4])
    pose, covariance = recipes[f"{name}_of_body"](result, cam_from_body)
    assert_like(covariance, local(pose, samples(result) @ cam_from_body))


def test_the_first_three_are_the_centre_along_the_cameras_axes() -> None:
    result = a_result()
    assert result.cam_from_world is not None and result.covariance is not None
    rotation = result.cam_from_world[:3, :3]
    centres = samples(result)[:, :3, 3] - se3.inverse(result.cam_from_world)[:3, 3]
    scale = np.sqrt(np.diag(result.covariance)[:3])
    sampled = np.cov(rotation @ centres.T) / np.outer(scale, scale)
    expected = result.covariance[:3, :3] / np.outer(scale, scale)
    np.testing.assert_allclose(sampled, expected, atol=0.06)
