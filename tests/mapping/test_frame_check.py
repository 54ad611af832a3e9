# SPDX-License-Identifier: Apache-2.0
"""How a splat and reference poses fit is measured; what does not is refused, by its right name."""

from __future__ import annotations

import functools
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_shot

from gscpe.errors import MapError, SettingsError
from gscpe.geometry import se3
from gscpe.geometry.pose_error import camera_centre
from gscpe.geometry.similarity_transform import Similarity
from gscpe.mapping import (
    FrameCheckSettings,
    check_frames,
    measure_misfit,
    scene_from_rgbd,
    with_fitting_axes,
)
from gscpe.mapping.diagnosis import rounded_coordinates
from gscpe.mapping.frame_candidates import nerfstudio_normalization
from gscpe.photos import write_image
from gscpe.scene import References
from gscpe.scene.moved import move_references, move_scene
from gscpe.splats import GaussianScene
from gscpe.splats.turned import Y_AND_Z_NEGATED, turned

CAMERA = room_camera(240, 180)
POSES = [
    se3.exp([0.04 * i - 0.08, 0.03 * (i % 2), 0.02 * i, 0.0, 0.015 * i - 0.03, 0.0]) @ ROOM_POSE
    for i in range(5)
]
MIDDLE = np.mean([camera_centre(pose) for pose in POSES], axis=0)


@functools.cache
def scene() -> GaussianScene:
    shot = room_shot()
    return scene_from_rgbd(shot.uint8, shot.depth, CAMERA, ROOM_POSE)


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for i, pose in enumerate(POSES):
        write_image(folder / f"{i}.png", room().shoot(CAMERA, pose, 2).uint8)
    return folder


def references(poses: list[NDArray[np.float64]] = POSES) -> References:
    names = tuple(f"{i}.png" for i in range(len(poses)))
    return References(names, np.stack(poses), (CAMERA,) * len(poses))


def moved(
    scale: float = 1.0,
    rotation: tuple[float, float, float] = (0, 0, 0),
    shift: tuple[float, float, float] = (0, 0, 0),
) -> Similarity:
    """About the middle of the cameras."""
    turn = se3.exp([0, 0, 0, *np.radians(rotation)])[:3, :3]
    return Similarity(scale, turn, MIDDLE - scale * turn @ MIDDLE + np.array(shift))


def test_the_right_frame_is_accepted_in_silence(
    photos: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        misfit = check_frames(scene(), references(), photos, matcher="sift")
    assert misfit is not None
    assert misfit.verdict(FrameCheckSettings()) == "fits"
    assert misfit.shift < 4e-3
    assert misfit.degrees < 0.1
    assert caplog.records == []


@pytest.mark.parametrize(
    "model_moved",
    [
        moved(shift=(0.05, 0, 0)),
        moved(rotation=(0, 1, 0)),
        moved(scale=1.3),
        moved(scale=1.1, rotation=(0.5, -1.0, 0.5), shift=(0.05, -0.05, 0.0)),
    ],
)
def test_a_misfit_is_refused_and_measured(model_moved: Similarity, photos: Path) -> None:
    poses = move_references(references(), model_moved)
    with pytest.raises(MapError, match=r"do not fit: against the model the splat is.*--fit"):
        check_frames(scene(), poses, photos, matcher="sift")
    misfit = measure_misfit(scene(), poses, photos, matcher="sift")
    np.testing.assert_allclose(misfit.splat_from_model.scale, 1.0 / model_moved.scale, atol=0.02)
    fitted = move_references(poses, misfit.splat_from_model)
    for pose, true in zip(fitted.cam_from_world, POSES, strict=True):
        assert np.linalg.norm(camera_centre(pose) - camera_centre(true)) < 6e-3
    mended = check_frames(scene(), fitted, photos, matcher="sift")
    assert mended is not None
    assert mended.verdict(FrameCheckSettings()) == "fits"


def test_the_splat_can_be_moved_in_place_of_the_poses(photos: Path) -> None:
    poses = move_references(references(), moved(1.1, (2.0, 0, 0), (0.02, 0.0, 0.0)))
    misfit = measure_misfit(scene(), poses, photos, matcher="sift")
    in_model = move_scene(scene(), misfit.splat_from_model.inverse())
    again = check_frames(in_model, poses, photos, matcher="sift")
    assert again is not None
    assert again.verdict(FrameCheckSettings()) == "fits"


def test_a_small_misfit_is_a_warning_with_numbers(
    photos: Path, caplog: pytest.LogCaptureFixture
) -> None:
    poses = move_references(references(), moved(shift=(0.02, 0, 0)))
    with caplog.at_level(logging.WARNING):
        misfit = check_frames(scene(), poses, photos, matcher="sift")
    assert misfit is not None
    assert misfit.shift == pytest.approx(0.02, abs=4e-3)
    assert "do not quite fit" in caplog.text
    assert "--fit" in caplog.text
    strict = FrameCheckSettings(max_shift=0.01)
    with pytest.raises(MapError, match="do not fit"):
        check_frames(scene(), poses, photos, strict, matcher="sift")


@pytest.mark.parametrize("unit", [1e-3, 500.0])
@pytest.mark.parametrize("known", [True, False])
def test_neither_unit_nor_origin_matter(unit: float, known: bool, photos: Path) -> None:
    """Both in other units and far away: they fit. The poses shifted, too: they do not."""
    there = Similarity(unit, np.eye(3), unit * np.array([5e5, 5.4e6, 250.0]))
    far, poses = move_scene(scene(), there), move_references(references(), there)
    metres_per_unit = 1.0 / unit if known else None
    fits = check_frames(
        far, poses, photos, metres_per_unit=metres_per_unit, backend="auto", matcher="sift"
    )
    assert fits is not None
    assert fits.shift < 4e-3 * unit
    aside = Similarity(1.0, np.eye(3), np.array([0.05 * unit, 0, 0]))
    with pytest.raises(MapError, match="do not fit"):
        check_frames(
            far,
            move_references(poses, aside),
            photos,
            metres_per_unit=metres_per_unit,
            matcher="sift",
        )


def test_one_good_reference_is_enough(photos: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Some photos may show what the splat shows badly."""
    away = se3.exp([0.0, 0.0, 0.0, 0.0, 2.0, 0.0])
    some = references([away @ POSES[0], away @ POSES[1], POSES[2]])
    assert check_frames(scene(), some, photos, matcher="sift") is None
    assert "too few photos are found" in caplog.text


def test_a_wrong_pose_among_right_ones_does_not_count(photos: Path) -> None:
    poses = [POSES[0] @ se3.exp([0.2, 0, 0, 0, 0, 0]), *POSES[1:]]
    misfit = measure_misfit(scene(), references(poses), photos, matcher="sift")
    assert misfit.verdict(FrameCheckSettings()) == "fits"


def test_an_arbitrary_frame_is_refused(photos: Path) -> None:
    elsewhere = moved(3.0, (70.0, 40.0, -100.0), (2.0, 1.0, 0.0))
    with pytest.raises(MapError, match=r"another frame or scale|nothing of the splat is visible"):
        check_frames(scene(), move_references(references(), elsewhere), photos, matcher="sift")


@pytest.mark.parametrize(
    ("what", "splat_from_model"),
    [
        ("y and z negated", Similarity(1.0, np.diag([1.0, -1.0, -1.0]), np.zeros(3))),
        ("by nerfstudio", nerfstudio_normalization(references(), Similarity.identity())),
    ],
)
def test_what_programs_do_is_recognized_and_mended(
    what: str, splat_from_model: Similarity, photos: Path
) -> None:
    splat = move_scene(scene(), splat_from_model)
    with pytest.raises(MapError, match=f"{what}.*--fit"):
        check_frames(splat, references(), photos, matcher="sift")
    misfit = measure_misfit(splat, references(), photos, matcher="sift")
    fitted = move_references(references(), misfit.splat_from_model)
    unit = 1.0 / splat_from_model.scale
    mended = check_frames(splat, fitted, photos, metres_per_unit=unit, matcher="sift")
    assert mended is not None
    assert mended.verdict(FrameCheckSettings()) == "fits"


@pytest.mark.parametrize("axes_are_open", [False, True])
@pytest.mark.parametrize("is_turned", [False, True])
def test_the_axes_that_fit_the_photos_are_taken(
    is_turned: bool, axes_are_open: bool, photos: Path, caplog: pytest.LogCaptureFixture
) -> None:
    right = scene()
    given = turned(right, Y_AND_Z_NEGATED) if is_turned else right
    with caplog.at_level(logging.WARNING):
        taken = with_fitting_axes(given, references(), photos, axes_are_open=axes_are_open)
    np.testing.assert_allclose(taken.means, right.means, atol=1e-6)
    assert ("y and z negated" in caplog.text) == is_turned
    assert (taken is given) == (not is_turned)


def test_where_neither_axes_fit_the_check_says_so(photos: Path) -> None:
    odd = move_scene(scene(), moved(rotation=(10.0, 80.0, 60.0), shift=(1.0, 2.0, 3.0)))
    assert with_fitting_axes(odd, references(), photos) is odd


def test_scales_that_are_no_logarithms_are_named(photos: Path) -> None:
    wrong = replace(scene(), scales=np.exp(scene().scales))
    with pytest.raises(MapError, match=r"about as large as the scene.*holds its scales as lengths"):
        check_frames(wrong, references(), photos, matcher="sift")


def test_a_few_gaussians_that_hide_the_scene_are_named(photos: Path) -> None:
    """What rows of zeros become: large, half opaque, grey, at the origin."""
    plain, count = scene(), 200
    centre = camera_centre(ROOM_POSE) + 0.8 * ROOM_POSE[2, :3]
    zeros = replace(
        plain,
        means=np.concatenate([plain.means, np.tile(centre, (count, 1)).astype(np.float32)]),
        quaternions=np.concatenate([plain.quaternions, plain.quaternions[:count]]),
        scales=np.concatenate([plain.scales, np.ones((count, 3), np.float32)]),
        opacities=np.concatenate([plain.opacities, np.full(count, 0.5, np.float32)]),
        sh=np.concatenate([plain.sh, np.zeros((count, *plain.sh.shape[1:]), np.float32)]),
    )
    with pytest.raises(MapError, match=f"{count} of .* as large as the scene.*Remove them"):
        check_frames(zeros, references(), photos, matcher="sift")


def test_nothing_visible_is_said_with_where_things_are(photos: Path) -> None:
    far = move_references(references(), Similarity(1.0, np.eye(3), np.array([5e5, 5.4e6, 0.0])))
    with pytest.raises(
        MapError, match=r"nothing of the splat is visible.*5\.4e\+06.*another origin"
    ):
        check_frames(scene(), far, photos, matcher="sift")


def test_poses_camera_to_world_show_nothing_or_another_place(photos: Path) -> None:
    behind = [se3.exp([0, 0, 0, 0, np.pi, 0]) @ pose for pose in POSES]
    behind = [pose @ se3.exp([0, 0, 0, 0, 0, 0.7]) for pose in behind]
    with pytest.raises(MapError, match=r"nothing of the splat is visible.*behind the cameras"):
        check_frames(scene(), references(behind), photos, matcher="sift")


def test_coordinates_that_lost_their_places_are_named() -> None:
    far = move_scene(scene(), Similarity(1.0, np.eye(3), np.array([5e5, 5.4e6, 250.0])))
    assert rounded_coordinates(far) is None
    world = (far.means + far.origin).astype(np.float32).astype(np.float64)
    rounded = replace(far, means=(world - far.origin).astype(np.float32))
    assert "in steps of 0.5 units" in str(rounded_coordinates(rounded))
    assert rounded_coordinates(scene()) is None


def test_settings_are_checked() -> None:
    with pytest.raises(SettingsError):
        FrameCheckSettings(references=0)
