# SPDX-License-Identifier: Apache-2.0
"""Every doubt has its reason, and a sound result has none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from gscpe.coarse import CoarseResult
from gscpe.geometry import Camera, se3
from gscpe.geometry.spread import spread_over_image
from gscpe.localization import FusionSettings, PosePrior, VerificationSettings
from gscpe.localization.sigmas import sigmas_text
from gscpe.localization.verification import (
    doubt_about_aligned,
    doubt_about_coarse,
    doubt_about_tracked,
)
from gscpe.refinement import RefinementResult
from gscpe.scene import MapFrame

CAMERA = Camera.pinhole(640, 480, fx=525, fy=525, cx=320, cy=240)
SETTINGS = VerificationSettings()
FUSION = FusionSettings()
FRAME = MapFrame()
GRID = np.stack(np.meshgrid([80, 240, 400, 560], [60, 180, 300, 420]), axis=-1).reshape(-1, 2)

COARSE = CoarseResult(
    cam_from_world=np.eye(4),
    covariance=1e-6 * np.eye(6),
    matches=100,
    inliers=64,
    inlier_pixels=np.repeat(GRID, 4, axis=0).astype(np.float64),
    rival_pixels=np.zeros((0, 2)),
    rms_pixels=0.8,
    rounds=2,
    converged=True,
)
ALIGNED = RefinementResult(
    cam_from_world=se3.exp([0.01, 0.0, 0.0, 0.0, 0.01, 0.0]),
    covariance=1e-6 * np.eye(6),
    gain=1.0,
    bias=0.0,
    residual=0.02,
    agreement=0.8,
    overlap=0.9,
    pixels=100_000,
    anchors=2,
    tolerance_unit=1.0,
    converged=True,
)
PRIOR = PosePrior(np.eye(4), translation_sigma=0.02, rotation_sigma_degrees=1.0)


def coarse_doubt(**changes: Any) -> str | None:
    return doubt_about_coarse(replace(COARSE, **changes), CAMERA, SETTINGS)


def aligned_doubt(**changes: Any) -> str | None:
    return doubt_about_aligned(COARSE, replace(ALIGNED, **changes), CAMERA, SETTINGS, FUSION, FRAME)


def tracked_doubt(**changes: Any) -> str | None:
    return doubt_about_tracked(PRIOR, replace(ALIGNED, **changes), SETTINGS, FRAME)


def test_no_doubt() -> None:
    assert coarse_doubt() is None
    assert aligned_doubt() is None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"cam_from_world": None, "matches": 7}, "no pose agrees with the 7 matches"),
        ({"inliers": 19}, "only 19 matches agree with a pose (20 needed)"),
        ({"matches": 640}, "only 10% of the matches agree (50% needed)"),
        (
            {"inlier_pixels": np.tile([[30.0, 40.0], [200.0, 100.0]], (32, 1))},
            "the matches cover only 12% of the photo (20% needed)",
        ),
        ({"inlier_pixels": np.full((64, 2), 5.0)}, "cover only 6% of the photo"),
    ],
)
def test_doubts_about_the_coarse_pose(changes: dict[str, Any], reason: str) -> None:
    doubt = coarse_doubt(**changes)
    assert doubt is not None
    assert reason in doubt


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"cam_from_world": None, "reason": "too little of the map"}, "too little of the map"),
        ({"cam_from_world": None, "reason": None}, "the refinement failed"),
        ({"overlap": 0.19}, "only 19% of the photo shows the map"),
        ({"agreement": 0.24}, "the map does not look like the photo at the estimated pose"),
        ({"agreement": -0.8}, "correlation -0.80, 0.25 needed"),
        ({"agreement": float("nan")}, "the map does not look like the photo"),
        (
            {"cam_from_world": se3.exp([0.11, 0, 0, 0, 0, 0])},
            "matches and image alignment contradict each other by 0.11 m",
        ),
        (
            {"cam_from_world": se3.exp([0, 0, 0, 0, np.radians(3.1), 0])},
            "contradict each other by 0 m and 3.10 degrees",
        ),
    ],
)
def test_doubts_about_the_aligned_pose(changes: dict[str, Any], reason: str) -> None:
    doubt = aligned_doubt(**changes)
    assert doubt is not None
    assert reason in doubt


def test_the_thresholds_themselves_are_enough() -> None:
    assert coarse_doubt(inliers=20, matches=40) is None
    assert coarse_doubt(matches=128) is None
    assert aligned_doubt(agreement=0.25, overlap=0.2) is None


@pytest.mark.parametrize(
    ("unit", "units_moved", "doubted"),
    [(0.1, 0.9, False), (0.1, 1.1, True), (10.0, 0.009, False), (10.0, 0.011, True)],
)
def test_metres_per_unit_scales_the_shift(unit: float, units_moved: float, doubted: bool) -> None:
    moved = se3.exp([units_moved, 0, 0, 0, 0, 0])
    assert (aligned_doubt(cam_from_world=moved, tolerance_unit=unit) is not None) == doubted


MANY = replace(
    COARSE, matches=400, inliers=240, inlier_pixels=np.repeat(GRID, 15, axis=0).astype(np.float64)
)


@pytest.mark.parametrize(
    ("changes", "agreement", "doubted"),
    [
        ({}, 0.11, False),
        ({}, 0.09, True),
        ({"matches": 500}, 0.11, True),
        ({"matches": 500}, 0.26, False),
        ({"matches": 300, "inliers": 190}, 0.11, True),
        ({"inlier_pixels": np.repeat(GRID[:8], 30, axis=0).astype(np.float64)}, 0.11, True),
    ],
)
def test_where_matches_decide_half_of_the_photo_may_have_changed(
    changes: dict[str, Any], agreement: float, doubted: bool
) -> None:
    coarse = replace(MANY, **changes)
    aligned = replace(ALIGNED, agreement=agreement)
    doubt = doubt_about_aligned(coarse, aligned, CAMERA, SETTINGS, FUSION, FRAME)
    assert (doubt is not None and "does not look like" in doubt) == doubted


@pytest.mark.parametrize(
    ("held", "by_rival", "doubt"),
    [
        (16, 8, None),
        (11, 8, None),
        (10, 5, "agree with two poses"),
        (16, 14, "agree with two poses"),
        (16, 0, "only 44% of the matches agree"),
    ],
)
def test_two_poses(held: int, by_rival: int, doubt: str | None) -> None:
    """Matches of what has been moved do not count against a pose that holds much more of the
    photo; less than half of all agree with it."""
    found = coarse_doubt(
        matches=550,
        inliers=240,
        inlier_pixels=np.repeat(GRID[:held], 15, axis=0).astype(np.float64),
        rival_pixels=np.repeat(GRID[:by_rival], 15, axis=0).astype(np.float64),
    )
    assert found is doubt is None or (found is not None and doubt is not None and doubt in found)


def test_where_something_has_moved_a_pose_must_hold_much_of_the_photo() -> None:
    """Matches of another attempt agreed on two poses; these agree on one."""
    assert doubt_about_coarse(COARSE, CAMERA, SETTINGS, moved=True) is None
    half = replace(COARSE, inlier_pixels=np.repeat(GRID[:9], 8, axis=0).astype(np.float64))
    assert doubt_about_coarse(half, CAMERA, SETTINGS) is None
    doubt = doubt_about_coarse(half, CAMERA, SETTINGS, moved=True)
    assert doubt is not None
    assert "cover only 56% of the photo (65% needed)" in doubt


def test_few_matches_do_not_excuse_others() -> None:
    """From 200 on, those of another pose are not counted; here, 150 of 310 agree."""
    few: dict[str, Any] = {
        "inlier_pixels": np.repeat(GRID, 10, axis=0)[:150].astype(np.float64),
        "rival_pixels": np.repeat(GRID[:5], 20, axis=0).astype(np.float64),
    }
    doubt = coarse_doubt(matches=310, inliers=150, **few)
    assert doubt is not None and "only 48% of the matches agree" in doubt


@pytest.mark.parametrize(
    ("sigmas", "unit", "doubted"),
    [
        ([0.09, 0.01, 0.01, 0.01, 0.01, 0.05], 1.0, False),
        ([0.01, 0.11, 0.01, 0.01, 0.01, 0.01], 1.0, True),
        ([0.01, 0.11, 0.01, 0.01, 0.01, 0.01], 0.5, False),
        ([0.01, 0.01, 0.01, 0.01, 0.06, 0.01], 0.5, True),
    ],
)
def test_a_pose_that_is_not_determined_is_doubted(
    sigmas: list[float], unit: float, doubted: bool
) -> None:
    changes: dict[str, Any] = {"covariance": np.diag(np.square(sigmas)), "tolerance_unit": unit}
    unsure = replace(COARSE, covariance=None)
    aligned = replace(ALIGNED, **changes)
    by_both = doubt_about_aligned(unsure, aligned, CAMERA, SETTINGS, FUSION, FRAME)
    for doubt in (by_both, tracked_doubt(**changes)):
        assert (doubt is not None and "does not determine the pose" in doubt) == doubted


def test_deviations_beyond_all_measure_are_capped() -> None:
    """A linear model says 705 degrees of what it does not know at all; NaN is no permission."""
    for deviation, metres, words in (
        (0.2, 1.0, "of 0.2 m and 11.46 degrees"),
        (12.3, 1.0, "of more than 2 m and more than 180 degrees"),
        (12.3, 0.5, "of more than 2 m and more than 180 degrees"),
        (np.inf, None, "of more than 1 units and more than 180 degrees"),
    ):
        frame = MapFrame(scale=metres or 2.0, metres_per_unit=metres)
        text = sigmas_text(deviation, float(np.degrees(deviation)), 1.0, frame)
        assert text == f"standard deviations {words}"
    doubt = tracked_doubt(covariance=150.0 * np.eye(6), tolerance_unit=0.5)
    assert doubt is not None and "more than 4 m and more than 180 degrees" in doubt


def test_every_doubt_names_a_next_step() -> None:
    far = se3.exp([0.5, 0, 0, 0, 0, 0])
    for doubt in (
        *(coarse_doubt(cam_from_world=None), coarse_doubt(inliers=3), coarse_doubt(matches=640)),
        *(coarse_doubt(inlier_pixels=GRID[:1].astype(float)), aligned_doubt(overlap=0.1)),
        *(aligned_doubt(agreement=0.1), aligned_doubt(cam_from_world=far)),
        *(tracked_doubt(converged=False), tracked_doubt(cam_from_world=far)),
        tracked_doubt(covariance=np.eye(6)),
    ):
        assert doubt is not None
        step = doubt.rpartition(": ")[2]
        assert any(word in step for word in ("try ", "check ", "give ")), doubt


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"agreement": 0.45}, "0.50 needed"),
        ({"converged": False}, "did not converge"),
        ({"cam_from_world": se3.exp([0.09, 0, 0, 0, 0, 0])}, "moved away from the prior by 0.09 m"),
        ({"cam_from_world": se3.exp([0, 0, 0, 0.08, 0, 0])}, "moved away from the prior"),
        ({"overlap": 0.1}, "only 10% of the photo"),
        ({"covariance": None, "reason": "nothing to see"}, "nothing to see"),
    ],
)
def test_tracking_needs_more(changes: dict[str, Any], reason: str) -> None:
    assert tracked_doubt() is None
    doubt = tracked_doubt(**changes)
    assert doubt is not None
    assert reason in doubt


@given(
    hnp.arrays(
        np.float64,
        st.tuples(st.integers(0, 40), st.just(2)),
        elements=st.floats(0, 480, exclude_max=True),
    )
)
def test_spread_counts_cells(pixels: NDArray[np.float64]) -> None:
    cells = {(int(u // 160), int(v // 120)) for u, v in pixels}
    assert spread_over_image(pixels, CAMERA) == len(cells) / 16.0


def test_spread_of_pixels_on_the_border() -> None:
    """Pixels may lie on the outermost border, or a little outside, and are counted there."""
    corners = np.array([[0.0, 0.0], [640.0, 480.0], [-0.3, 480.2], [640.4, -0.1]])
    assert spread_over_image(corners, CAMERA) == 4 / 16.0


def test_an_alignment_that_determines_nothing_contradicts_nothing() -> None:
    """Then the matches decide, if they are twice as sure as needed."""
    far = se3.exp([0.4, 0, 0, 0, 0, 0])
    assert aligned_doubt(cam_from_world=far, covariance=4.0 * np.eye(6)) is None
    undetermined = replace(ALIGNED, cam_from_world=far, covariance=4.0 * np.eye(6))
    unsure = replace(COARSE, covariance=np.diag([0.06**2, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6]))
    doubt = doubt_about_aligned(unsure, undetermined, CAMERA, SETTINGS, FUSION, FRAME)
    assert doubt is not None
    assert "does not determine the pose" in doubt
    assert doubt_about_aligned(unsure, ALIGNED, CAMERA, SETTINGS, FUSION, FRAME) is None
