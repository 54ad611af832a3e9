# SPDX-License-Identifier: Apache-2.0
"""Where the page opens: inside of walls, before what cameras went around, upright."""

from __future__ import annotations

import numpy as np
from helpers import random_pose
from numpy.typing import NDArray
from scenes import ROOM_POSE, furnished_room, room_map, splat_of

from gscpe.geometry import Camera, se3
from gscpe.geometry.projection import transform_points
from gscpe.scene import GlobalDescriptors, Map, References
from gscpe.viewer import Findings, contents_of
from gscpe.viewer.cameras import frustum_corners
from gscpe.viewer.framing import upright_rotation
from gscpe.viewer.opening import from_afar, opening

CAMERA = Camera.pinhole(80, 60, fx=60.0, fy=60.0, cx=40.0, cy=30.0)
UP = np.array([0.0, 0.0, 1.0])


def look(eye: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """``cam_from_world`` of an upright camera; z is up."""
    rotation = upright_rotation((at - eye) / np.linalg.norm(at - eye), UP)
    return se3.from_rotation_translation(rotation, -rotation @ eye)


def map_of(poses: list[NDArray[np.float64]]) -> Map:
    """The furnished room, with photos of these poses."""
    names = tuple(f"{number}.png" for number in range(len(poses)))
    stacked = np.array(poses).reshape(-1, 4, 4)
    nothing = np.zeros((len(poses), 1), dtype=np.float32)
    return Map.of(
        splat_of(furnished_room(), 0.08),
        References(names, stacked, (CAMERA,) * len(poses)),
        GlobalDescriptors(np.zeros((0, 0), np.float32), nothing, "onnx"),
    )


def opened(map_: Map, findings: Findings | None = None) -> tuple[NDArray[np.float64], ...]:
    """The eye, where it looks and its up, in the world."""
    contents = contents_of(map_, findings)
    begin = opening(contents, map_.scene, "cpu")
    turn = se3.from_quaternion_translation(begin.quaternion, [0, 0, 0])[:3, :3]
    eye = map_.frame.origin + begin.position / map_.frame.scale
    return eye, turn[:, 2], -turn[:, 1]


def test_all_cameras_are_seen_from_afar(rng: np.random.Generator) -> None:
    here = {f"{i}": se3.exp([0.1 * i - 0.2, 0, 0.1, 0, 0.05 * i, 0]) @ ROOM_POSE for i in range(4)}
    for poses in (here, {str(i): random_pose(rng) for i in range(5)}):
        contents = contents_of(room_map(), Findings(poses=poses))
        afar = from_afar(contents)
        map_from_cam = se3.from_quaternion_translation(afar.quaternion, afar.position)
        for shown in contents.cameras:
            corners = frustum_corners(shown.camera, shown.cam_from_map, contents.frustum_depth)
            ahead = transform_points(se3.inverse(map_from_cam), corners)
            assert np.all(ahead[:, 2] > 0)
            across = np.abs(ahead[:, :2]) / ahead[:, 2:]
            assert np.all(across < np.tan(afar.vertical_angle / 2) * np.array([1.6, 1.0]))


def inside(point: NDArray[np.float64]) -> bool:
    return bool(np.all(np.abs(point - [0, 0, 1.2]) < [2.0, 1.7, 1.2]))


def test_inside_of_the_walls() -> None:
    """From afar, one sees the walls from behind."""
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    around = [np.array([np.cos(a), np.sin(a), 0.0]) for a in angles]
    stand = np.array([-0.3, 0.1, 1.4])
    map_ = map_of([look(stand - 0.4 * a, stand + a - 0.2 * UP) for a in around])
    eye, ahead, up = opened(map_)
    assert inside(eye)
    assert abs(ahead @ UP) < 0.5
    assert up @ UP > 0.85
    afar = from_afar(contents_of(map_))
    assert not inside(map_.frame.origin + afar.position / map_.frame.scale)


def test_before_what_cameras_went_around() -> None:
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    eyes = [np.array([6 * np.cos(a), 6 * np.sin(a), 1.5]) for a in angles]
    middle = np.array([0, 0, 1.2])
    eye, ahead, up = opened(map_of([look(each, middle) for each in eyes]))
    assert np.linalg.norm(eye - middle) > 4.0
    assert ahead @ (middle - eye) / np.linalg.norm(middle - eye) > 0.9
    assert up @ UP > 0.85


def test_a_trajectory_alone_and_nothing_at_all() -> None:
    map_ = map_of([])
    eye, ahead, _ = opened(map_)
    assert ahead @ (np.array([0, 0, 1.2]) - eye) > 2.0
    steps = [look(np.array([0.1 * i - 0.5, 0, 1.4]), np.array([0, 5.0, 1.4])) for i in range(10)]
    walk = Findings(trajectory={float(i): pose for i, pose in enumerate(steps)})
    eye, *_ = opened(map_, walk)
    assert inside(eye)
