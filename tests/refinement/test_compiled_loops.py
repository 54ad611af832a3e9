# SPDX-License-Identifier: Apache-2.0
"""The compiled loops do what NumPy does."""

from __future__ import annotations

from dataclasses import replace
from typing import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, RayCastRenderer, room, room_camera

from gscpe.geometry import se3
from gscpe.photos import luminance
from gscpe.refinement import LucasKanadeSettings, VisibilitySettings
from gscpe.refinement.lucas_kanade import Alignment, align
from gscpe.refinement.products import (
    combined,
    inner_products,
    sums_by_label,
    weighted_squares,
)
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.template import build_template, residuals_of
from gscpe.refinement.visibility import visibility_mask

pytest.importorskip("numba")

CAMERA = room_camera(160, 120)
STEP = se3.exp([0.03, -0.02, 0.05, 0.02, -0.03, 0.06])
SETTINGS = LucasKanadeSettings()


def levels(holes: float) -> tuple[AnchorLevel, ImageLevel]:
    rng = np.random.default_rng(1)
    shot = room(2, smoothness=2.0).shoot(CAMERA, ROOM_POSE)
    photo = room(2, smoothness=2.0).shoot(CAMERA, STEP @ ROOM_POSE)
    whole = np.ones(shot.depth.shape, dtype=bool)
    grey = luminance(photo.rgb.astype(np.float32)) * np.float32(0.8) + np.float32(0.1)
    valid = rng.uniform(size=whole.shape) >= holes
    anchor = AnchorLevel(luminance(shot.rgb.astype(np.float32)), whole, CAMERA, shot.depth)
    return anchor, ImageLevel(grey.astype(np.float32), valid, CAMERA)


@pytest.fixture
def use_numpy(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Turns the loops off, everywhere, once it is called."""

    def off() -> None:
        for name in ("lucas_kanade", "products", "template", "visibility"):
            monkeypatch.setattr(f"gscpe.refinement.{name}.compiled_loops", lambda: None)

    return off


@pytest.mark.parametrize("holes", [0.0, 0.1])
@pytest.mark.parametrize(
    "pose",
    [
        se3.exp([1e-3, 0, 0, 0, 0, 2e-3]),
        STEP,
        se3.exp([0, 0, -2.2, 0, 0, 0]),
        se3.exp([0, 0, 0, 0, 2.0, 0]),
    ],
)
def test_residuals(holes: float, pose: NDArray[np.float64], use_numpy: Callable[[], None]) -> None:
    anchor, photo = levels(holes)
    template = build_template(anchor, SETTINGS)
    assert template is not None
    fast, fast_usable = residuals_of(template, photo, pose, 0.9, 0.05)
    use_numpy()
    slow, slow_usable = residuals_of(template, photo, pose, 0.9, 0.05)
    # A point on the border itself may fall to either side.
    assert np.count_nonzero(fast_usable != slow_usable) <= 3
    both = fast_usable & slow_usable
    np.testing.assert_allclose(fast[both], slow[both], atol=2e-5)
    assert not np.any(fast[~fast_usable])


@pytest.mark.parametrize("most", [500, 100_000])
def test_templates(most: int, use_numpy: Callable[[], None]) -> None:
    """The same pixels, also where a template is thinned; points and Jacobians to rounding."""
    rng = np.random.default_rng(2)
    anchor, _ = levels(0.0)
    anchor = replace(anchor, valid=rng.uniform(size=anchor.valid.shape) >= 0.01)
    settings = replace(SETTINGS, max_template_pixels=most)
    fast = build_template(anchor, settings)
    use_numpy()
    slow = build_template(anchor, settings)
    assert fast is not None and slow is not None
    assert len(fast.intensities) <= 1.1 * most
    np.testing.assert_array_equal(fast.intensities, slow.intensities)
    np.testing.assert_allclose(fast.points, slow.points, rtol=1e-6, atol=1e-6)
    scale = np.abs(slow.jacobian).max(axis=0)
    np.testing.assert_allclose(fast.jacobian / scale, slow.jacobian / scale, atol=1e-5)
    np.testing.assert_allclose(fast.motion, slow.motion, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("count", [1, 127, 128, 1000])
def test_products(count: int, use_numpy: Callable[[], None]) -> None:
    rng = np.random.default_rng(count)
    a, b = (rng.normal(size=(rows, count)).astype(np.float32) for rows in (8, 3))
    np.testing.assert_allclose(inner_products(a, b), a @ b.T, atol=1e-3)
    np.testing.assert_allclose(inner_products(a[::2], b), a[::2] @ b.T, atol=1e-3)
    matrix = rng.normal(size=(4, 3)).astype(np.float32)
    np.testing.assert_allclose(combined(matrix, b), matrix @ b, atol=1e-5)
    np.testing.assert_allclose(combined(matrix[:3].T, b), matrix[:3].T @ b, atol=1e-5)
    weights = rng.uniform(-1, 1, count).astype(np.float32)
    np.testing.assert_allclose(weighted_squares(a, weights), (a * weights) @ a.T, atol=1e-3)
    labels = rng.integers(0, 7, count)
    expected = np.stack([np.bincount(labels, row) for row in a])
    np.testing.assert_allclose(sums_by_label(labels, a), expected, atol=1e-4)
    use_numpy()
    np.testing.assert_allclose(sums_by_label(labels, a), expected)
    np.testing.assert_allclose(weighted_squares(a, weights), (a * weights) @ a.T, atol=1e-3)
    np.testing.assert_allclose(inner_products(a, b), a @ b.T, atol=1e-3)
    np.testing.assert_array_equal(combined(matrix, b), matrix @ b)


@pytest.mark.parametrize("settings", [{}, {"robust": False}, {"gain_and_bias": False}])
def test_alignments(settings: dict[str, bool], use_numpy: Callable[[], None]) -> None:
    anchor, photo = levels(0.05)
    solver = LucasKanadeSettings(**settings)
    template = build_template(anchor, solver)
    assert template is not None

    def solve() -> Alignment:
        near = se3.exp([0.005, 0, 0, 0, 0.004, 0]) @ STEP
        found = align(template, photo, near, 0.8, 0.1, solver)
        assert found is not None
        return found

    fast = solve()
    use_numpy()
    slow = solve()
    assert fast.iterations == slow.iterations
    assert fast.pixels == slow.pixels
    np.testing.assert_allclose(fast.photo_from_anchor, slow.photo_from_anchor, atol=2e-6)
    assert fast.gain == pytest.approx(slow.gain, abs=1e-5)
    assert fast.residual == pytest.approx(slow.residual, rel=1e-3)


def test_votes(use_numpy: Callable[[], None]) -> None:
    """A board before a wall: the views see what is behind it, and past the anchor's borders."""
    camera = room_camera(160, 120)
    renderer = RayCastRenderer(room())
    anchor = renderer.render(camera, ROOM_POSE)
    depth = anchor.depth.copy()
    depth[40:70, 20:50] -= np.float32(0.3)
    anchor = replace(anchor, depth=depth)
    masks = [visibility_mask(renderer, anchor, VisibilitySettings(views=3), 1.0)]
    use_numpy()
    masks.append(visibility_mask(renderer, anchor, VisibilitySettings(views=3), 1.0))
    assert 0.5 < masks[0].mean() < 0.95
    assert np.count_nonzero(masks[0] != masks[1]) <= 3  # on the border of a view's pixel
