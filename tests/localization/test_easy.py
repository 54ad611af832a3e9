# SPDX-License-Identifier: Apache-2.0
"""An easy photo is matched with a small render and with the one that is aligned; where that leaves
a doubt, the whole coarse loop decides."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import LocalizationResult, Localizer, LocalizerSettings
from gscpe.coarse import AbsolutePose, CoarseSettings, Round
from gscpe.errors import SettingsError
from gscpe.geometry import pose_difference, se3
from gscpe.localization import EasySettings, Observer, VerificationSettings
from gscpe.localization.easy import is_easy
from gscpe.matching import Matches
from gscpe.matching.protocol import no_matches
from gscpe.render import RenderedView

CAMERA = room_camera(480, 360)
TRUTH = np.asarray(se3.exp([0.06, -0.03, 0.05, 0.02, -0.03, 0.01]) @ ROOM_POSE)
EASY = EasySettings(side=90, min_references=1)
"""Half of the size of the room's photo, which is the map's only one."""


@pytest.fixture(scope="module")
def image() -> NDArray[np.uint8]:
    return room().shoot(CAMERA, TRUTH, samples=2).uint8


class Looks(Observer):
    """Widths of the renders that were matched, anchors, and the threads that told of them."""

    def __init__(self) -> None:
        self.widths: list[int] = []
        self.anchors: list[RenderedView] = []
        self.threads: set[int] = set()

    def round_done(
        self, view: RenderedView, matches: Matches, estimate: AbsolutePose | None
    ) -> None:
        self.widths.append(view.camera.width)
        self.threads.add(threading.get_ident())

    def anchor_rendered(self, view: RenderedView) -> None:
        self.anchors.append(view)
        self.threads.add(threading.get_ident())


def localize(
    image: NDArray[np.uint8], looks: Looks | None = None, **settings: Any
) -> LocalizationResult:
    with Localizer(room_map(), LocalizerSettings(**settings), "sift") as localizer:
        return localizer.localize(image, CAMERA, observer=looks)


@pytest.mark.parametrize(
    "wrong",
    [
        {"side": -240},
        {"side": 4},
        {"min_references": -1},
        {"min_inliers": 0},
        {"min_inlier_share": 1.5},
        {"min_spread": math.nan},
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        EasySettings(**wrong)


def test_two_matches_and_the_render_that_is_aligned(image: NDArray[np.uint8]) -> None:
    looks = Looks()
    result = localize(image, looks, easy=EASY)
    assert result.localized, result.reason
    assert result.coarse is not None and result.aligned is not None
    assert looks.widths == [120, 240]  # the map's photos are 240 pixels wide
    assert len(looks.anchors) == result.aligned.anchors
    assert result.coarse.rounds == 2
    assert looks.threads == {threading.get_ident()}
    for pose in (result.cam_from_world, result.coarse.cam_from_world):
        assert pose is not None
        error = pose_difference(pose, TRUTH)
        assert error.distance < 4e-3 and error.degrees < 0.1


def test_as_exact_as_the_whole_loop(image: NDArray[np.uint8]) -> None:
    """The map's own errors are left, a few millimetres."""
    easy, whole = localize(image, easy=EASY), localize(image, easy=EasySettings(side=0))
    assert easy.coarse is not None and whole.coarse is not None
    assert whole.coarse.rounds > 1
    assert easy.cam_from_world is not None and whole.cam_from_world is not None
    apart = pose_difference(easy.cam_from_world, whole.cam_from_world)
    assert apart.distance < 1.5e-3 and apart.degrees < 0.03


def test_the_same_with_one_core_and_with_two(
    image: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch
) -> None:
    poses = []
    for cores in ("1", "2"):
        monkeypatch.setenv("GSCPE_THREADS", cores)
        poses.append(localize(image, easy=EASY).cam_from_world)
    assert poses[0] is not None and poses[1] is not None
    np.testing.assert_array_equal(poses[0], poses[1])


@pytest.mark.parametrize(
    "settings",
    [
        {"easy": replace(EASY, min_inliers=100_000)},  # it is not easy at first sight,
        {"easy": EASY, "verification": VerificationSettings(min_inliers=100_000)},  # or at last
    ],
)
def test_what_is_not_easy_goes_through_the_whole_loop(
    settings: dict[str, Any], image: NDArray[np.uint8]
) -> None:
    looks = Looks()
    result = localize(image, looks, more_places=0, **settings)
    assert looks.widths[0] == 120
    whole = localize(image, None, more_places=0, **{**settings, "easy": EasySettings(side=0)})
    assert result.coarse is not None and whole.coarse is not None
    assert result.localized == whole.localized
    assert result.reason == whole.reason
    np.testing.assert_array_equal(result.coarse.cam_from_world, whole.coarse.cam_from_world)


def test_a_photo_that_is_hardly_larger_goes_through_the_whole_loop(
    image: NDArray[np.uint8],
) -> None:
    looks = Looks()
    assert localize(image, looks, easy=replace(EASY, side=121)).localized
    assert set(looks.widths) == {240}


def test_a_map_of_one_photo_is_matched_by_the_whole_loop(image: NDArray[np.uint8]) -> None:
    looks = Looks()
    assert localize(image, looks, easy=EasySettings(side=90)).localized
    assert set(looks.widths) == {240}


@pytest.mark.parametrize("covered", [np.s_[:, :240], np.s_[:180]], ids=["left", "top"])
def test_a_photo_half_covered_goes_through_the_whole_loop(
    covered: Any, image: NDArray[np.uint8]
) -> None:
    looks, half = Looks(), image.copy()
    half[covered] = (70, 60, 50)
    localize(half, looks, easy=EASY, more_places=0, escalate=False, orientations=())
    assert looks.widths[0] == 120
    assert looks.widths.count(240) == len(looks.widths) - 1
    easy = localize(half, None, easy=EASY, more_places=0, escalate=False, orientations=())
    whole = localize(
        half, None, easy=EasySettings(side=0), more_places=0, escalate=False, orientations=()
    )
    assert easy.localized == whole.localized
    if easy.cam_from_world is not None:
        np.testing.assert_array_equal(easy.cam_from_world, whole.cam_from_world)


def seen(inliers: int, others: int, cells: int) -> Round:
    """A round with so many matches, the inliers spread over so many cells of a 4x4 grid."""
    camera = room_camera(160, 120)
    cell = np.arange(inliers) % max(cells, 1)
    pixels = np.stack([20.0 + 40.0 * (cell % 4), 15.0 + 30.0 * (cell // 4)], axis=1)
    pixels = np.concatenate([pixels, np.zeros((others, 2))])
    agree = np.arange(inliers + others) < inliers
    estimate = AbsolutePose(ROOM_POSE, agree, 1.0, np.eye(6)) if inliers else None
    nothing: Any = None
    return Round(nothing, camera, no_matches(), np.zeros((len(pixels), 3)), pixels, estimate)


@pytest.mark.parametrize(
    ("inliers", "others", "cells", "expected"),
    [
        (80, 20, 12, True),
        (40, 10, 12, False),  # few
        (80, 90, 12, False),  # against many
        (80, 20, 8, False),  # in one half
        (0, 90, 0, False),
    ],
)
def test_what_is_easy(inliers: int, others: int, cells: int, expected: bool) -> None:
    assert is_easy(seen(inliers, others, cells), EasySettings()) == expected


def test_a_round_without_a_pose_says_so() -> None:
    result = seen(0, 30, 0).result(1, False, CoarseSettings())
    assert result.cam_from_world is None
    assert (result.matches, result.inliers, result.rounds) == (30, 0, 1)
    assert np.isnan(result.rms_pixels)
    assert len(result.inlier_pixels) == 0
