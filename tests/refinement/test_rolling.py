# SPDX-License-Identifier: Apache-2.0
"""Photos whose rows were exposed one after another, by a camera that moved meanwhile."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, away_from_creases, room, room_camera

from gscpe.geometry import se3
from gscpe.geometry.projection import pose_jacobian, unproject_image
from gscpe.photos import luminance
from gscpe.refinement.lucas_kanade import Alignment, align
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.rolling import pose_of_all_rows
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.template import Template, build_template

CAMERA = room_camera(160, 120)
WORLD = room(smoothness=2.0)
SHOT = WORLD.shoot(CAMERA, ROOM_POSE)
VALID = away_from_creases(SHOT)
PLACE = (np.arange(120) + 0.5) / 120 - 0.5
BAND = 5
MOTION = np.array([0.012, 0.02, -0.008, 0.008, -0.012, 0.01])
"""Of points, between the first row and the last: 1.3 pixels, root mean square."""


def rolled(motion: NDArray[np.float64]) -> NDArray[np.float32]:
    """The luminance of a photo whose rows see the world moved by their share."""
    rows = []
    for first in range(0, 120, BAND):
        share = PLACE[first : first + BAND].mean()
        shot = WORLD.shoot(CAMERA, se3.exp(share * motion) @ ROOM_POSE)
        rows.append(luminance(shot.rgb.astype(np.float32))[first : first + BAND])
    return np.concatenate(rows)


def fading(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """With much texture above, and little below."""
    contrast = np.linspace(1.0, 0.1, 120)[:, None]
    return np.asarray(0.5 + contrast * (image - 0.5), dtype=np.float32)


def mean_motion(motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the whole camera, that moves all pixels most like the rows' motions."""
    chosen = np.flatnonzero(VALID)
    points = unproject_image(CAMERA, SHOT.depth, chosen).T.astype(np.float64)
    jacobian = pose_jacobian(CAMERA, points)
    shifts = (jacobian @ motion) * PLACE[chosen // 160][:, None]
    found = np.linalg.lstsq(jacobian.reshape(-1, 6), shifts.ravel(), rcond=None)[0]
    return np.asarray(found, dtype=np.float64)


def errors(
    motion: NDArray[np.float64], solver: LucasKanadeSettings, rolling_pixels: float
) -> tuple[float, float]:
    """Pixels by which the alignment, and the pose of all rows, are off the mean motion."""
    grey = fading(luminance(SHOT.rgb.astype(np.float32)))
    template = build_template(AnchorLevel(grey, VALID, CAMERA, SHOT.depth), solver)
    assert template is not None
    photo = ImageLevel(fading(rolled(motion)), np.ones((120, 160), bool), CAMERA)
    found = align(template, photo, np.eye(4), 1.0, 0.0, solver)
    assert found is not None
    pose = pose_of_all_rows(template, photo, found, solver, rolling_pixels, 10).photo_from_anchor
    true = se3.exp(mean_motion(motion))
    return off(template, found.photo_from_anchor, true), off(template, pose, true)


def off(template: Template, pose: NDArray[np.float64], true: NDArray[np.float64]) -> float:
    xi = se3.log(pose @ se3.inverse(true))
    return float(np.sqrt(xi @ template.motion @ xi))


@pytest.mark.parametrize(
    "solver",
    [LucasKanadeSettings(), LucasKanadeSettings(robust=False, gain_and_bias=False)],
    ids=["default", "plain least squares"],
)
def test_the_pose_is_that_of_all_rows_wherever_the_texture_is(
    solver: LucasKanadeSettings,
) -> None:
    before, after = errors(MOTION, solver, 1.0)
    assert before > 0.15
    assert after < 0.2 * before


def test_a_photo_that_was_exposed_at_once_stays_where_it_is() -> None:
    before, after = errors(np.zeros(6), LucasKanadeSettings(), 1.0)
    assert max(before, after) < 0.02


def test_along_stripes_the_pose_stays_where_the_alignment_left_it() -> None:
    """What nothing determines is not moved: a wall with the same stripes in every row."""
    stripes = np.tile(0.5 + 0.3 * np.sin(np.arange(160) / 3.0), (120, 1)).astype(np.float32)
    depth, everywhere = np.full((120, 160), 2.0, np.float32), np.ones((120, 160), bool)
    solver = LucasKanadeSettings()
    template = build_template(AnchorLevel(stripes, everywhere, CAMERA, depth), solver)
    assert template is not None
    photo = ImageLevel(stripes, everywhere, CAMERA)
    found = Alignment(np.eye(4), 1.0, 0.0, 0.01, len(template.intensities), 0.0, 1, True)
    rows = pose_of_all_rows(template, photo, found, solver, 1.0, 10)
    assert off(template, rows.photo_from_anchor, np.eye(4)) < 1e-6
    assert np.all(np.isfinite(rows.by_camera))


def test_a_strong_prior_holds_the_second_motion_at_zero() -> None:
    before, after = errors(MOTION, LucasKanadeSettings(), 1e-4)
    assert after == pytest.approx(before, abs=0.02)


@pytest.mark.parametrize(("extreme", "same"), [(1e-300, 1e-9), (1e300, 1e9)])
def test_extreme_priors_are_as_good_as_certain(extreme: float, same: float) -> None:
    solver = LucasKanadeSettings()
    assert errors(MOTION, solver, extreme) == errors(MOTION, solver, same)
