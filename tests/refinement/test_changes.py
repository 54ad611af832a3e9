# SPDX-License-Identifier: Apache-2.0
"""What has been moved, or has come, is left out of the alignment."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, RayCastRenderer, room, room_camera, room_map

from gscpe import Localizer, LocalizerSettings
from gscpe.geometry import pose_difference, se3
from gscpe.localization import VerificationSettings, stages
from gscpe.photos import Photo
from gscpe.refinement import RefinementResult, RefinementSettings, refine_pose
from gscpe.refinement.changes import without_changes
from gscpe.render import Renders

CAMERA = room_camera(321, 241)
TRUTH = np.asarray(se3.exp([0.04, -0.03, 0.05, 0.02, -0.02, 0.01]) @ ROOM_POSE)


def changed(columns: slice, strength: float = 1.0) -> NDArray[np.uint8]:
    """The room, but in these columns a picture of another room, with so much contrast."""
    picture = room().shoot(CAMERA, TRUTH, samples=2).rgb
    other = 0.5 + strength * (room(7).shoot(CAMERA, ROOM_POSE, samples=2).rgb[::-1] - 0.5)
    picture[:, columns] = other[:, columns]
    return np.asarray(np.rint(255 * np.clip(picture, 0, 1)), np.uint8)


def test_what_has_come_is_left_out() -> None:
    view = RayCastRenderer(room()).render(CAMERA, TRUTH)
    photo = Photo(changed(slice(180, 321)), CAMERA)
    left = without_changes(photo, view)
    assert left is not None and left.valid is not None
    assert left.valid.shape == photo.rgb.shape[:2]
    assert left.valid[:, :160].mean() > 0.97
    assert left.valid[:, 200:].mean() < 0.3
    np.testing.assert_array_equal(left.rgb, photo.rgb)


def test_what_was_masked_stays_masked() -> None:
    view = RayCastRenderer(room()).render(CAMERA, TRUTH)
    valid = np.ones((241, 321), dtype=bool)
    valid[:100] = False
    left = without_changes(Photo(changed(slice(180, 321)), CAMERA, valid), view)
    assert left is not None and left.valid is not None
    assert not left.valid[:100].any()
    assert left.valid[110:, :160].mean() > 0.97


@pytest.mark.parametrize("columns", [slice(0, 0), slice(0, 321)])
def test_nothing_or_everything_has_changed(columns: slice) -> None:
    view = RayCastRenderer(room()).render(CAMERA, TRUTH)
    assert without_changes(Photo(changed(columns), CAMERA), view) is None


def test_the_alignment_is_better_for_it() -> None:
    """Two thirds of the photo show another room."""
    start = se3.exp([0.004, -0.003, 0.004, 0.001, -0.002, 0.001]) @ TRUTH
    renderer, photo = RayCastRenderer(room()), Photo(changed(slice(107, 321), 1.5), CAMERA)
    left = without_changes(photo, renderer.render(CAMERA, start))
    assert left is not None
    errors = []
    for each in (left, photo):
        found = refine_pose(renderer, each, start, RefinementSettings())
        assert found.cam_from_world is not None
        errors.append(pose_difference(found.cam_from_world, TRUTH).distance)
    assert errors[0] < 1e-3
    assert errors[0] < 0.3 * errors[1]


@pytest.mark.parametrize(
    ("agreement", "inliers", "again"), [(0.9, 50, True), (0.3, 50, False), (0.9, 500, False)]
)
def test_alignments_in_doubt_are_repeated(
    agreement: float, inliers: int, again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where photo and map are not alike enough, and enough matches agree; how alike the whole photo
    is remains known."""
    picture = room().shoot(CAMERA, TRUTH, samples=2).uint8
    other = room(7).shoot(CAMERA, ROOM_POSE, samples=2).uint8[::-1]
    for row in range(6):
        for column in range(row % 2, 6, 2):
            block = slice(40 * row, 40 * row + 40), slice(53 * column, 53 * column + 53)
            picture[block] = other[block]
    masked: list[bool] = []

    def refine(renderer: Renders, photo: Photo, *rest: Any) -> RefinementResult:
        """Determines no pose of the whole photo, as where more than half of it has changed."""
        found = refine_pose(renderer, photo, *rest)
        masked.append(photo.valid is not None)
        nothing = 100.0 * np.eye(6)
        return found if masked[-1] else replace(found, covariance=nothing, unshared=nothing)

    monkeypatch.setattr(stages, "refine_pose", refine)
    trust = VerificationSettings(changed_agreement=agreement, decisive_inliers=inliers)
    with Localizer(room_map(), LocalizerSettings(verification=trust), "sift") as localizer:
        result = localizer.localize(picture, CAMERA)
    assert result.localized == again, result.reason
    assert any(masked) == again
    if result.cam_from_world is None:
        assert result.reason is not None and "does not determine the pose" in result.reason
        return
    assert masked == [False, True]
    assert result.aligned is not None
    assert pose_difference(result.cam_from_world, TRUTH).distance < 0.01
    assert 0.3 < result.aligned.agreement < 0.6
