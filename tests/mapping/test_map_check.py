# SPDX-License-Identifier: Apache-2.0
"""A finished map is good when its own references come back to their own poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_shot

from gscpe.errors import MapError, SettingsError
from gscpe.geometry import se3
from gscpe.geometry.similarity_transform import Similarity
from gscpe.mapping import (
    MapCheckSettings,
    MapSettings,
    build_map,
    check_map,
    map_without_references,
    scene_from_rgbd,
)
from gscpe.photos import write_image
from gscpe.scene import Map, References, open_map, save_map
from gscpe.scene.moved import move_references
from gscpe.splats import GaussianScene

CAMERA = room_camera(240, 180)
POSES = [se3.exp([0.04 * i - 0.04, 0, 0, 0, 0.02 * i, 0]) @ ROOM_POSE for i in range(3)]


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for i, pose in enumerate(POSES):
        write_image(folder / f"{i}.png", room().shoot(CAMERA, pose, 2).uint8)
    return folder


@pytest.fixture(scope="module")
def map_(photos: Path) -> Map:
    shot = room_shot()
    scene = scene_from_rgbd(shot.uint8, shot.depth, CAMERA, ROOM_POSE)
    return built(scene, photos)


def built(scene: GaussianScene, photos: Path, model_moved: Similarity | None = None) -> Map:
    references = References(("0.png", "1.png", "2.png"), np.stack(POSES), (CAMERA,) * 3)
    if model_moved is not None:
        references = move_references(references, model_moved)
    return build_map(scene, references, photos, MapSettings(retrieval="vlad"))


def test_a_good_map(map_: Map, photos: Path, tmp_path: Path) -> None:
    save_map(map_, tmp_path / "m.gsmap")
    check = check_map(open_map(tmp_path / "m.gsmap"), photos, matcher="sift")
    assert check.good
    assert [each.name for each in check.references] == ["0.png", "1.png", "2.png"]
    assert all(each.returned and each.distance < 5e-3 for each in check.references)
    assert str(check).startswith("3 of 3 reference photos come back to their own poses")


@pytest.mark.parametrize(
    "model_moved",
    [
        Similarity(1.0, np.eye(3), np.array([0.05, 0, 0])),
        Similarity(1.0, se3.exp([0, 0, 0, 0, 0.0175, 0])[:3, :3], np.zeros(3)),
    ],
)
def test_moved_references_do_not_come_back(
    model_moved: Similarity, map_: Map, photos: Path
) -> None:
    check = check_map(built(map_.scene, photos, model_moved), photos, matcher="sift")
    assert not check.good
    assert "0 of 3" in str(check)
    assert "3 are localized elsewhere" in str(check)
    assert "of its standard deviations" in str(check)
    lenient = MapCheckSettings(max_shift=0.1, max_degrees=2.0)
    assert check_map(built(map_.scene, photos, model_moved), photos, lenient, matcher="sift").good


def test_a_spoilt_splat_localizes_nothing(map_: Map, photos: Path) -> None:
    """As compressing beside a far outlier does: places are lost."""
    step = 0.3
    spoilt = replace(map_.scene, means=np.round(map_.scene.means / step) * np.float32(step))
    check = check_map(replace(map_, scene=spoilt), photos, matcher="sift")
    assert not check.good
    assert "not localized, for example" in str(check)


def test_the_unit_of_a_distance_is_the_users(map_: Map, photos: Path) -> None:
    there = Similarity(100.0, np.eye(3), np.array([5e7, 0, 0]))
    from gscpe.scene.moved import move_scene

    references = move_references(map_.references, there)
    far = build_map(
        move_scene(map_.scene, there), references, photos, MapSettings(metres_per_unit=0.01)
    )
    check = check_map(far, photos, matcher="sift")
    assert check.good
    assert 0.0 < max(each.distance for each in check.references) < 0.5  # centimetres


def test_without_references_there_is_nothing_to_check(map_: Map, tmp_path: Path) -> None:
    with pytest.raises(MapError, match="without reference photos"):
        check_map(map_without_references(map_.scene), tmp_path)
    virtual = replace(map_, references=replace(map_.references, virtual=True))
    with pytest.raises(MapError, match="renders of its splat"):
        check_map(virtual, tmp_path)
    with pytest.raises(SettingsError):
        MapCheckSettings(references=0)
