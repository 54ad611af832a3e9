# SPDX-License-Identifier: Apache-2.0
"""Maps of one RGB-D photo: they look like the photo, and stand where the depth says."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, away_from_creases, room, room_camera, room_map, room_shot

from gscpe.errors import CameraError, PhotoError, PoseError, SettingsError
from gscpe.geometry import Camera, se3
from gscpe.geometry.projection import transform_points
from gscpe.mapping import RgbdMapSettings, map_from_rgbd, scene_from_rgbd
from gscpe.render import RenderedView, Renderer

CAMERA = room_camera(240, 180)
SMALL = room_camera(60, 45)


def render(camera: Camera = CAMERA, pose: NDArray[np.float64] = ROOM_POSE) -> RenderedView:
    with Renderer(room_map().scene) as renderer:
        return renderer.render(camera, pose)


def small_shot() -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    shot = room().shoot(SMALL, ROOM_POSE)
    return shot.uint8, shot.depth


def test_it_looks_like_the_photo() -> None:
    view = render()
    inner = (view.opacity > 0.9) & away_from_creases(room_shot(), 2)
    assert inner.mean() > 0.8
    difference = np.abs(view.rgb - room_shot().rgb)[inner]
    assert difference.mean() < 0.005  # a grey value
    depth = np.abs(view.depth - room_shot().depth)[inner]
    assert np.median(depth) < 3e-3  # a quarter of a pixel
    assert np.quantile(depth, 0.99) < 0.02


def median_shift(view: RenderedView, rgb: NDArray[np.floating], seen: NDArray[np.bool_]) -> float:
    """Median length of the flow, in pixels, that turns the render into the photo: least squares
    over blocks of 30x30 pixels, gain and bias free."""
    photo, picture = (image.astype(np.float32).mean(axis=2) for image in (rgb, view.rgb))
    by_u = cv2.Scharr(photo, cv2.CV_32F, 1, 0, scale=1 / 32)
    by_v = cv2.Scharr(photo, cv2.CV_32F, 0, 1, scale=1 / 32)
    lengths = []
    for row in range(0, photo.shape[0] - 29, 30):
        for column in range(0, photo.shape[1] - 29, 30):
            block = (slice(row, row + 30), slice(column, column + 30))
            kept = seen[block]
            if kept.mean() > 0.7:
                columns = [by_u[block], by_v[block], photo[block], np.ones((30, 30))]
                design = np.stack([c[kept] for c in columns], axis=1)
                flow = np.linalg.lstsq(design, (photo - picture)[block][kept], rcond=None)[0][:2]
                lengths.append(np.hypot(*flow))
    assert len(lengths) >= 10
    return float(np.median(lengths))


def test_it_is_not_shifted() -> None:
    """Measured: 0.002 px at the photo's own pose, 0.04 px from 9 cm beside."""
    for step, limit in ((np.zeros(6), 0.01), (np.array([0.05, -0.04, 0.06, 0.02, -0.03, 0]), 0.08)):
        pose = se3.exp(step) @ ROOM_POSE
        view, shot = render(pose=pose), room().shoot(CAMERA, pose, samples=2)
        seen = (view.opacity > 0.9) & away_from_creases(shot, 1)
        assert median_shift(view, shot.rgb, seen) < limit


def test_surfels_lie_on_the_surface() -> None:
    """Flat, thin, in layers less than a pixel (11 mm) apart, and none between the board and the
    wall behind it."""
    scene = room_map().scene
    means = scene.means.astype(np.float64)
    distances = [np.abs((means - p.origin) @ np.cross(*p.axes)) for p in room().planes]
    assert np.min(distances, axis=0).max() < 0.012
    thin, wide = np.sort(scene.scales, axis=1)[:, [0, 2]].T
    assert np.all(thin < 0.2 * wide)
    depth = transform_points(ROOM_POSE, means)[:, 2]
    assert 0.2 * np.median(depth) / CAMERA.fx < np.median(wide) < np.median(depth) / CAMERA.fx


def test_unknown_depth_leaves_holes() -> None:
    rgb, depth = small_shot()
    broken = depth.copy()
    broken[10:20, 10:20] = np.nan
    broken[10:20, 25:35] = np.inf
    broken[25:35, 10:20] = 0.0
    broken[25:35, 25:35] = -1.0
    opacities = []
    for some_depth in (depth, broken):
        with Renderer(scene_from_rgbd(rgb, some_depth, SMALL, ROOM_POSE)) as renderer:
            opacities.append(renderer.render(SMALL, ROOM_POSE).opacity)
    whole, holed = opacities
    near_a_hole = np.zeros(depth.shape, dtype=bool)
    for row in (10, 25):
        for column in (10, 25):
            assert holed[row + 2 : row + 8, column + 2 : column + 8].max() < 0.05
            near_a_hole[row - 4 : row + 14, column - 4 : column + 14] = True
    np.testing.assert_allclose(holed[~near_a_hole], whole[~near_a_hole], atol=1e-5)
    assert whole[2:8, 2:8].min() > 0.9


def test_the_map_holds_its_photo() -> None:
    rgb, depth = small_shot()
    map_ = map_from_rgbd(rgb, depth, SMALL, ROOM_POSE, "some/where/photo.png")
    assert map_.references.names == ("photo.png",)
    assert map_.references.cameras == (SMALL,)
    np.testing.assert_array_equal(map_.references.cam_from_world, ROOM_POSE[None])
    assert map_.metres_per_unit == 1.0
    unknown = map_from_rgbd(rgb, depth, SMALL, ROOM_POSE, metres_per_unit=None)
    assert unknown.metres_per_unit is None


def test_input_is_left_as_it_was() -> None:
    rgb, depth = small_shot()
    depth[3, 4] = np.nan
    copies = rgb.copy(), depth.copy(), ROOM_POSE.copy()
    scene_from_rgbd(rgb, depth, SMALL, ROOM_POSE)
    for before, after in zip(copies, (rgb, depth, ROOM_POSE), strict=True):
        np.testing.assert_array_equal(before, after)


def test_wrong_input() -> None:
    rgb, depth = small_shot()
    with pytest.raises(CameraError, match="the photo is 60x45"):
        scene_from_rgbd(rgb, depth, CAMERA, ROOM_POSE)
    with pytest.raises(CameraError, match="the depth image is 30x45"):
        scene_from_rgbd(rgb, depth[:, :30], SMALL, ROOM_POSE)
    with pytest.raises(PhotoError, match="fewer than 100 usable pixels"):
        scene_from_rgbd(rgb, np.zeros_like(depth), SMALL, ROOM_POSE)
    with pytest.raises(PhotoError, match="undistort the RGB-D photo first"):
        bent = Camera(60, 45, 50, 50, 30, 22, (0.1, 0, 0, 0, 0, 0, 0, 0))
        scene_from_rgbd(rgb, depth, bent, ROOM_POSE)
    with pytest.raises(PoseError, match="cam_from_world"):
        scene_from_rgbd(rgb, depth, SMALL, 2.0 * np.eye(4))


@pytest.mark.parametrize("change", [{"surfel_sigma": 0.0}, {"thickness": -1.0}, {"opacity": 1.0}])
def test_impossible_settings(change: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(change))):
        RgbdMapSettings(**change)
