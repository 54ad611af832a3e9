# SPDX-License-Identifier: Apache-2.0
"""The whole pipeline around an exact renderer: what it adds to the error is next to nothing.

The splat renderer is replaced by the ray caster. Photos come from cameras of other sizes,
focal lengths and principal points than the map's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, RayCastRenderer, room, room_camera, room_map

import gscpe.localization.localizer
from gscpe import Localizer
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.photos import to_photo
from gscpe.retrieval import describe_references
from gscpe.scene import Map, References
from gscpe.splats import GaussianScene

CAMERAS = {
    "small": Camera.pinhole(161, 121, fx=131.0, fy=128.0, cx=91.0, cy=52.0),
    "large": Camera.pinhole(300, 220, fx=270.0, fy=280.0, cx=140.0, cy=125.0),
    "distorted": Camera.parse("OPENCV,240,180,190,195,126,84,-0.1,0.02,0.002,-0.001"),
}
POSE = se3.exp([0.08, -0.05, 0.06, 0.02, -0.04, 0.06]) @ ROOM_POSE


@dataclass
class ExactRenderer(RayCastRenderer):
    """Stands where the localizer expects its renderer."""

    def close(self) -> None:
        pass


@pytest.fixture
def map_(monkeypatch: pytest.MonkeyPatch) -> Map:
    """A map with references around the room; its Gaussians are never rendered."""

    def stand_in(scene: GaussianScene, *_: object) -> ExactRenderer:
        return ExactRenderer(room())

    monkeypatch.setattr(gscpe.localization.localizer, "Renderer", stand_in)
    camera = room_camera(240, 180)
    turns = (-0.6, 0.0, 0.6, 1.2)
    poses = np.stack([se3.exp([0.1, 0, 0, 0, turn, 0]) @ ROOM_POSE for turn in turns])
    photos = [to_photo(room().shoot(camera, pose).uint8, camera) for pose in poses]
    return Map(
        scene=room_map().scene,
        references=References(tuple(f"{i}.png" for i in range(4)), poses, (camera,) * 4),
        descriptors=describe_references(photos),
    )


def photo(camera: Camera, pose: NDArray[np.float64] = POSE) -> NDArray[np.uint8]:
    return room().shoot(camera, pose).uint8


@pytest.mark.parametrize("name", CAMERAS)
def test_exact_for_any_camera(name: str, map_: Map) -> None:
    with Localizer(map_) as localizer:
        result = localizer.localize(photo(CAMERAS[name]), CAMERAS[name])
    assert result.cam_from_world is not None, result.reason
    assert result.reference == "1.png"
    assert result.aligned is not None
    assert result.aligned.cam_from_world is not None
    for cam_from_world, factor in ((result.aligned.cam_from_world, 1), (result.cam_from_world, 3)):
        error = pose_difference(cam_from_world, POSE)
        assert error.distance < factor * 0.15e-3
        assert error.degrees < factor * 0.004


def test_half_a_pixel_end_to_end(map_: Map) -> None:
    """The principal point half a pixel off, as if it were OpenCV's: 25 times the error above."""
    camera = CAMERAS["large"]
    with Localizer(map_) as localizer:
        for wrong in (replace(camera, cx=camera.cx - 0.5), replace(camera, cy=camera.cy + 0.5)):
            result = localizer.localize(photo(camera), wrong)
            assert result.cam_from_world is not None
            error = pose_difference(result.cam_from_world, POSE)
            assert error.distance > 1e-3 or error.degrees > 0.05


def test_each_photo_starts_from_its_nearest_reference(map_: Map) -> None:
    camera = room_camera(240, 180)
    with Localizer(map_) as localizer:
        for index in (0, 2):
            pose = map_.references.cam_from_world[index]
            result = localizer.localize(photo(camera, pose), camera)
            assert result.reference == f"{index}.png"
            assert result.cam_from_world is not None, result.reason
            assert pose_difference(result.cam_from_world, pose).distance < 0.15e-3


def test_a_wrong_first_reference_is_overcome(map_: Map) -> None:
    """The descriptors are shuffled: the right reference comes second or third."""
    known = map_.descriptors
    shuffled = replace(known, descriptors=known.descriptors[[1, 0, 2, 3]])
    with Localizer(replace(map_, descriptors=shuffled)) as localizer:
        result = localizer.localize(photo(CAMERAS["large"]), CAMERAS["large"])
    assert result.cam_from_world is not None, result.reason
    assert pose_difference(result.cam_from_world, POSE).distance < 0.45e-3
