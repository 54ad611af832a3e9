"""A splat and poses of different frames are refused before a map is made of them."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe.errors import MapError
from gscpe.geometry import se3
from gscpe.mapping import check_frames, with_fitting_axes
from gscpe.scene import References, write_image
from gscpe.scene.turned import Y_AND_Z_NEGATED, turned

CAMERA = room_camera(240, 180)
POSES = [se3.exp([0.02 * i, 0.0, 0.0, 0.0, 0.01 * i, 0.0]) @ ROOM_POSE for i in range(3)]


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for i, pose in enumerate(POSES):
        write_image(folder / f"{i}.png", room().shoot(CAMERA, pose).uint8)
    return folder


def references(poses: list[NDArray[np.float64]]) -> References:
    names = tuple(f"{i}.png" for i in range(len(poses)))
    return References(names, np.stack(poses), (CAMERA,) * len(poses))


def test_the_right_frame_is_accepted(photos: Path) -> None:
    check_frames(room_map().scene, references(POSES), photos)


def test_one_good_reference_is_enough(photos: Path) -> None:
    """Some photos may show what the splat shows badly."""
    away = se3.exp([0.0, 0.0, 0.0, 0.0, 2.0, 0.0])
    check_frames(room_map().scene, references([away @ POSES[0], away @ POSES[1], POSES[2]]), photos)


@pytest.mark.parametrize("change", ["scale", "turn", "move", "camera to world"])
def test_another_frame_is_refused(change: str, photos: Path) -> None:
    poses = [pose.copy() for pose in POSES]
    for i, pose in enumerate(poses):
        if change == "scale":
            pose[:3, 3] *= 3.0
            pose[:3, 3] += (0.0, 0.0, 2.0)
        elif change == "turn":
            poses[i] = pose @ se3.exp([0.0, 0.0, 0.0, 0.0, 0.4, 0.3])
        elif change == "move":
            poses[i] = pose @ se3.exp([0.5, 0.3, 0.4, 0.0, 0.0, 0.0])
        else:
            poses[i] = se3.inverse(pose)
    with pytest.raises(MapError, match=r"does not look like the photos.*another frame or scale"):
        check_frames(room_map().scene, references(poses), photos)


@pytest.mark.parametrize("axes_are_open", [False, True])
@pytest.mark.parametrize("is_turned", [False, True])
def test_the_axes_that_fit_the_photos_are_taken(
    is_turned: bool, axes_are_open: bool, photos: Path, caplog: pytest.LogCaptureFixture
) -> None:
    right = room_map().scene
    given = turned(right, Y_AND_Z_NEGATED) if is_turned else right
    with caplog.at_level(logging.WARNING):
        taken = with_fitting_axes(given, references(POSES), photos, axes_are_open=axes_are_open)
    np.testing.assert_allclose(taken.means, right.means, atol=1e-6)
    assert ("y and z negated" in caplog.text) == is_turned
    assert (taken is given) == (not is_turned)


def test_neither_axes_fit(photos: Path) -> None:
    quarter = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    with pytest.raises(MapError, match="does not look like the photos"):
        with_fitting_axes(turned(room_map().scene, quarter), references(POSES), photos)
