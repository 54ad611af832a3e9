# SPDX-License-Identifier: Apache-2.0
"""Lifting pixels of a render to world points, with exact depth from the ray caster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, RayCastRenderer, away_from_creases, room, room_camera, wall

from gscpe.coarse.lift import lift
from gscpe.geometry.projection import pixel_centres, project, transform_points
from gscpe.render import RenderedView

CAMERA = room_camera(160, 120)


@pytest.fixture(scope="module")
def view() -> RenderedView:
    return RayCastRenderer(room()).render(CAMERA, ROOM_POSE)


def in_camera(view: RenderedView, points_world: NDArray[np.float64]) -> NDArray[np.float64]:
    return transform_points(view.cam_from_world, points_world)


def test_points_project_back_to_their_pixels(view: RenderedView, rng: np.random.Generator) -> None:
    """Also beyond the outermost pixel centres."""
    pixels = rng.uniform([0.0, 0.0], [CAMERA.width, CAMERA.height], (300, 2))
    points, liftable = lift(view, pixels)
    assert points.shape == (300, 3)
    assert liftable.all()
    np.testing.assert_allclose(project(CAMERA, in_camera(view, points)), pixels, atol=1e-9)


def test_pixel_centres_have_their_own_depth(view: RenderedView) -> None:
    pixels = pixel_centres(CAMERA).reshape(-1, 2)
    points, _ = lift(view, pixels)
    np.testing.assert_allclose(in_camera(view, points)[:, 2], view.depth.ravel(), atol=1e-9)


def test_points_lie_on_the_planes(view: RenderedView, rng: np.random.Generator) -> None:
    """Between pixel centres too: 0.3 mm at 2.5 m, as depth is not quite linear on a slant."""
    shot = room().shoot(CAMERA, ROOM_POSE)
    pixels = rng.uniform([1.0, 1.0], [CAMERA.width - 1.0, CAMERA.height - 1.0], (2000, 2))
    row, column = np.rint(pixels[:, ::-1] - 0.5).astype(int).T
    pixels = pixels[away_from_creases(shot, 2)[row, column]]
    points, _ = lift(view, pixels)
    distances = [np.abs((points - p.origin) @ np.cross(*p.axes)) for p in room().planes]
    assert np.min(distances, axis=0).max() < 3e-4


def test_half_a_pixel(rng: np.random.Generator) -> None:
    """A wall from straight ahead, two metres away: x is known by hand."""
    view = RayCastRenderer(wall(2.0)).render(CAMERA, np.eye(4))
    points, _ = lift(view, np.array([[CAMERA.cx, CAMERA.cy], [0.5, 0.5]]))
    np.testing.assert_allclose(points[0], [0, 0, 2], atol=1e-6)
    corner = [(0.5 - CAMERA.cx) / CAMERA.fx * 2, (0.5 - CAMERA.cy) / CAMERA.fy * 2, 2]
    np.testing.assert_allclose(points[1], corner, atol=1e-6)


def test_no_point_hangs_between_two_surfaces(view: RenderedView) -> None:
    """Across the board's edge a point takes the surface of the nearest pixel."""
    jump = np.diff(view.depth, axis=1) / view.depth[:, 1:]
    rows, columns = np.nonzero(np.abs(jump) > 0.1)
    assert len(rows) > 50
    for share in (0.1, 0.4, 0.6, 0.9):
        pixels = np.stack([columns + 0.5 + share, rows + 0.5], axis=1)
        points, liftable = lift(view, pixels)
        nearest = view.depth[rows, columns + (share > 0.5)]
        assert liftable.all()
        np.testing.assert_allclose(in_camera(view, points)[:, 2], nearest, rtol=0.03)


def test_holes_cannot_be_lifted(view: RenderedView) -> None:
    opacity, depth = view.opacity.copy(), view.depth.copy()
    opacity[10:20, 10:20] = 0.49
    depth[30:40, 10:20] = 0.0
    holed = replace(view, opacity=opacity, depth=depth)
    pixels = np.array([[15.5, 15.5], [15.5, 35.5], [50.5, 15.5], [10.2, 15.5], [9.8, 15.5]])
    points, liftable = lift(holed, pixels)
    assert liftable.tolist() == [False, False, True, False, True]
    assert np.isfinite(points).all()
    # Beside the hole only the seen pixel's depth counts.
    assert in_camera(holed, points)[4, 2] == pytest.approx(view.depth[15, 9])
    assert lift(holed, pixels, min_opacity=0.4)[1].tolist() == [True, False, True, True, True]


def test_no_pixels(view: RenderedView) -> None:
    points, liftable = lift(view, np.zeros((0, 2)))
    assert points.shape == (0, 3)
    assert liftable.shape == (0,)
