# SPDX-License-Identifier: Apache-2.0
"""Viewpoints that are found in a splat alone: inside, upright, overlapping; or an error."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import random_rotation
from numpy.typing import NDArray
from scenes import furnished_room, splat_of

from gscpe import MapSettings, map_with_virtual_references
from gscpe.errors import MapError, SettingsError, SplatError
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.geometry.projection import pixel_centres, transform_points, unproject
from gscpe.geometry.similarity_transform import Similarity
from gscpe.localization import Localizer, LocalizerSettings
from gscpe.making import CertificateSettings, certify_virtual, summary_table
from gscpe.photos import to_uint8
from gscpe.render import Renderer
from gscpe.scene import Map, open_map, save_map
from gscpe.scene.moved import move_scene
from gscpe.splats import GaussianScene
from gscpe.viewpoints import Viewpoints, ViewpointSettings, find_viewpoints

CAMERA = Camera.pinhole(240, 180, fx=200.0, fy=200.0, cx=120.0, cy=90.0)
SETTINGS = ViewpointSettings(camera=CAMERA, most=60, seeds=12, grown=16, between=16)
UP = np.array([0.0, 0.0, 1.0])


@functools.cache
def room() -> GaussianScene:
    return splat_of(furnished_room())


@functools.cache
def found() -> Viewpoints:
    return find_viewpoints(room(), SETTINGS)


@functools.cache
def map_of_room() -> Map:
    some = replace(found(), cam_from_world=found().cam_from_world[::2])
    return map_with_virtual_references(room(), MapSettings(), some)


def centres(cam_from_world: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(-np.einsum("nij,ni->nj", cam_from_world[:, :3, :3], cam_from_world[:, :3, 3]))


def inside(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.all((points > [-1.9, -1.6, 0.1]) & (points < [1.9, 1.6, 2.3]), axis=1))


def test_viewpoints_lie_inside_the_room_and_look_level() -> None:
    poses = found().cam_from_world
    assert 20 <= len(found()) <= SETTINGS.most
    assert inside(centres(poses)).all()
    assert found().up @ UP > np.cos(np.deg2rad(2.0))
    assert np.abs(poses[:, 0, :3] @ UP).max() < 0.04  # the images' rows are level
    assert (-poses[:, 1, :3] @ UP).min() > 0.9


def test_nothing_is_too_near_and_all_is_seen() -> None:
    with Renderer(replace(room(), near=0.01)) as renderer:
        for pose in found().cam_from_world[::6]:
            view = renderer.render(CAMERA.resized(80, 60), pose)
            assert np.mean(view.opacity > 0.5) > 0.9
            assert np.quantile(view.depth[view.depth > 0], 0.05) > 0.1


def test_views_overlap_and_look_all_around() -> None:
    """Half of what a view shows is seen by another one; and every wall by some."""
    poses, camera = found().cam_from_world, CAMERA.resized(40, 30)
    with Renderer(replace(room(), near=0.01)) as renderer:
        depths = [renderer.render(camera, pose).depth.astype(np.float64) for pose in poses]
    best = []
    for i, (pose, depth) in enumerate(zip(poses, depths, strict=True)):
        points = unproject(camera, pixel_centres(camera).reshape(-1, 2), depth.ravel())
        points = transform_points(np.linalg.inv(pose), points)
        shares = [
            share_seen(points, poses[j], depths[j], camera) for j in range(len(poses)) if j != i
        ]
        best.append(max(shares))
    assert np.median(best) > 0.5
    for direction in np.vstack([np.eye(3)[:2], -np.eye(3)[:2]]):
        assert (poses[:, 2, :3] @ direction).max() > np.cos(np.deg2rad(35.0))


def share_seen(
    points: NDArray[np.float64],
    pose: NDArray[np.float64],
    depth: NDArray[np.float64],
    camera: Camera,
) -> float:
    x, y, z = transform_points(pose, points).T
    z = np.maximum(z, 1e-9)
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    at = (z > 0.05) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    there = depth[v[at].astype(int), u[at].astype(int)]
    return float(np.count_nonzero(np.abs(there - z[at]) < 0.1 * z[at]) / len(points))


@pytest.mark.parametrize("scale", [0.01, 300.0])
def test_neither_unit_nor_axes_need_be_known(scale: float) -> None:
    turn = random_rotation(np.random.default_rng(int(scale)))
    move = Similarity(scale, turn, scale * np.array([3.0, -50.0, 7.0]))
    moved = find_viewpoints(move_scene(room(), move), SETTINGS)
    assert moved.up @ (turn @ UP) > np.cos(np.deg2rad(3.0))
    back = (centres(moved.cam_from_world) - move.translation) @ turn / scale
    assert inside(back).all()


def test_an_origin_far_away_is_added_once() -> None:
    origin = np.array([5e5, 4e6, 100.0])
    far = find_viewpoints(
        replace(room(), origin=origin), replace(SETTINGS, seeds=6, grown=6, between=0)
    )
    assert inside(centres(far.cam_from_world) - origin).all()


def test_up_can_be_given() -> None:
    given = find_viewpoints(room(), replace(SETTINGS, up=(0.0, -3.0, 0.3)))
    up = np.array([0.0, -3.0, 0.3]) / np.linalg.norm([0.0, -3.0, 0.3])
    assert given.up_was_given and not found().up_was_given
    assert given.up == pytest.approx(up)
    assert np.abs(given.cam_from_world[:, 0, :3] @ up).max() < 1e-9


def test_how_far_views_look_down_can_be_given_or_found() -> None:
    """They all look equally far down: as is said, or as the splat looks best."""
    quick = replace(SETTINGS, seeds=6, grown=6, between=0)
    steep = find_viewpoints(room(), replace(quick, pitch_down=35.0))
    assert -steep.cam_from_world[:, 2, :3] @ steep.up == pytest.approx(np.sin(np.deg2rad(35.0)))
    down = -found().cam_from_world[:, 2, :3] @ found().up
    assert np.ptp(down) < 1e-9
    assert np.sin(np.deg2rad(-21.0)) < down[0] < np.sin(np.deg2rad(41.0))


def test_the_map_is_certified_by_renders_from_beside_its_viewpoints() -> None:
    """The room is found again; a map whose references tell nothing is poor, and says so."""
    settings = CertificateSettings(renders=4)
    certificate = certify_virtual(map_of_room(), settings, matcher="sift")
    assert certificate.of_renders and len(certificate.photos) == 4
    assert certificate.localized >= 0.75 and certificate.relative_error < 0.005
    assert "renders from beside its viewpoints" in certificate.explanation()
    assert "PSNR" not in [row[0] for row in summary_table(certificate).rows]
    assert certificate == certify_virtual(map_of_room(), settings, matcher="sift")
    map_ = map_of_room()
    moved = replace(
        map_.references,
        cam_from_world=se3.exp([0, 0, 0, 3.0, 0, 0]) @ map_.references.cam_from_world,
    )
    blind = replace(map_, references=replace(moved, virtual=True))
    with pytest.raises(MapError, match="nothing is seen"):
        certify_virtual(replace(blind, scene=far_away(map_.scene)), settings, matcher="sift")
    with pytest.raises(MapError, match="only a map of virtual references"):
        certify_virtual(replace(map_, references=replace(moved, virtual=False)))


def far_away(scene: GaussianScene) -> GaussianScene:
    return replace(scene, means=scene.means + np.float32(1000.0))


def test_photos_are_localized_without_any_photo_in_the_map() -> None:
    map_ = map_of_room()
    assert map_.references.virtual and "virtual references" in repr(map_)
    settings = LocalizerSettings(escalate=False)
    with Localizer(map_, matcher="sift", settings=settings) as localizer:
        for pose in poses_of_a_guest():
            photo = to_uint8(localizer.render(CAMERA, pose).rgb)
            result = localizer.localize(photo, CAMERA)
            assert result.cam_from_world is not None, result.reason
            off = pose_difference(result.cam_from_world, pose)
            assert off.distance < 0.01 and off.degrees < 0.2


def poses_of_a_guest() -> list[NDArray[np.float64]]:
    """Cameras in the room, not quite level, at places of their own."""
    poses = []
    for place, yaw in (((0.3, -0.4, 1.5), 1.0), ((-0.7, 0.5, 1.3), -0.6)):
        forward = np.array([np.cos(yaw), np.sin(yaw), -0.2])
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, UP)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ np.array(place)
        poses.append(se3.exp([0, 0, 0, 0.02, 0.0, 0.06]) @ pose)
    return poses


def test_the_map_folder_says_that_its_references_are_virtual(tmp_path: Path) -> None:
    save_map(map_of_room(), tmp_path / "m.gsmap")
    opened = open_map(tmp_path / "m.gsmap")
    assert opened.references.virtual
    assert opened.references.names == map_of_room().references.names


def test_haze_and_a_line_have_no_viewpoint() -> None:
    rng = np.random.default_rng(0)
    count = 1000
    haze = GaussianScene(
        means=rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (count, 1)),
        scales=np.full((count, 3), 0.15, dtype=np.float32),
        opacities=np.full(count, 0.05, dtype=np.float32),
        sh=rng.normal(size=(count, 1, 3)).astype(np.float32),
    )
    with pytest.raises(MapError, match="no viewpoint"):
        find_viewpoints(haze, SETTINGS)
    line = replace(haze, means=haze.means * np.array([1, 0, 0], dtype=np.float32))
    with pytest.raises(MapError, match="no viewpoint"):
        find_viewpoints(line, SETTINGS)


@pytest.mark.parametrize(
    "wrong",
    [
        {"most": 0},
        {"seeds": 0},
        {"grown": -1},
        {"between": -1},
        {"spacing": math.nan},
        {"clearance": math.inf},
        {"yaw_step": 0.0},
        {"margin": -0.1},
        {"pitch_down": 90.0},
        {"min_covered": 1.1},
        {"max_thickness": math.nan},
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        ViewpointSettings(**wrong)


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(SettingsError, match="up must be"):
        ViewpointSettings(up=(0.0, 0.0, 0.0))
    with pytest.raises(SettingsError, match="pinhole"):
        ViewpointSettings(camera=Camera.parse("SIMPLE_RADIAL,640,480,500,320,240,0.1"))
    with pytest.raises(SplatError, match="GaussianScene"):
        map_with_virtual_references("splat.ply")  # type: ignore[arg-type]
