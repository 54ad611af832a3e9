# SPDX-License-Identifier: Apache-2.0
"""Photos from one spot are told from a walk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import room
from walks import WALK_CAMERA, write_jpeg

from gscpe.errors import ReconstructionError
from gscpe.geometry import se3
from gscpe.reconstruction import reconstruct
from gscpe.reconstruction.parallax import beyond_turning


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.4), st.floats(0.0, 0.3))
def test_what_turning_does_not_explain(seed: int, wrong: float, step: float) -> None:
    """It is as large as the step over the depth, whatever the turn and the wrong matches."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.8, 0.8, (300, 2)), np.ones(300)])
    points *= rng.uniform(1.0, 3.0, (300, 1))
    direction = rng.normal(size=3)
    b_from_a = se3.exp([*(step * direction / np.linalg.norm(direction)), *rng.normal(0, 0.1, 3)])
    in_b = points @ b_from_a[:3, :3].T + b_from_a[:3, 3]
    focal = 0.9
    a, b = (focal * each[:, :2] / each[:, 2:] for each in (points, in_b))
    bad = rng.random(300) < wrong
    b[bad] = rng.uniform(-0.7, 0.7, (np.count_nonzero(bad), 2))
    found = beyond_turning(a, b, focal)
    if wrong < 0.35 and step == 0.0:
        assert found < 1e-9
    assert found <= step + 1e-9 or wrong > 0.1
    if step > 0.1 and abs(direction[2]) < 0.7 * np.linalg.norm(direction):
        assert found > 0.05 * step


def test_photos_from_one_spot_are_refused(tmp_path: Path) -> None:
    """pycolmap alone places them all."""
    for i in range(7):
        pose = se3.exp([0, 0, 0, 0.02 * np.sin(i), 0.14 * (i - 3), 0])
        write_jpeg(tmp_path / "pan" / f"{i}.jpg", room().shoot(WALK_CAMERA, pose, samples=2).uint8)
    with pytest.raises(ReconstructionError, match=r"one spot.*Step sideways"):
        reconstruct(tmp_path / "pan", tmp_path / "model")
