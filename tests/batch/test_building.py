# SPDX-License-Identifier: Apache-2.0
"""A photo looked for in the rooms of a building."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera

from gscpe.batch import Building, OnePhoto, Shelf, shelf_order
from gscpe.cli.main import main
from gscpe.errors import MapError
from gscpe.geometry import pose_difference, se3
from gscpe.mapping import map_from_rgbd
from gscpe.scene import open_map, save_map, write_image
from gscpe.scene.map_folder import open_references
from gscpe.scene.poses.hloc import parse_pose

CAMERA = room_camera(240, 180)
NAMES = ("kitchen", "office", "hall")
POSE = se3.exp([0.05, -0.03, 0.01, 0.02, -0.02, 0.03]) @ ROOM_POSE


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three rooms, painted differently, and a photo of each; and one of a room without a map."""
    folder = tmp_path_factory.mktemp("house")
    for seed, name in enumerate((*NAMES, "elsewhere")):
        world = room(seed)
        write_image(folder / f"{name}.png", world.shoot(CAMERA, POSE).uint8)
        if name in NAMES:
            shot = world.shoot(CAMERA, ROOM_POSE)
            map_ = map_from_rgbd(shot.uint8, shot.depth, CAMERA, ROOM_POSE, f"{name}.png")
            save_map(map_, folder / f"{name}.gsmap")
    return folder


def maps(house: Path) -> list[str]:
    return [str(house / f"{name}.gsmap") for name in NAMES]


def photo(house: Path, name: str) -> OnePhoto:
    path = house / f"{name}.png"
    return OnePhoto.decode(path.read_bytes(), path, CAMERA)


def test_each_photo_is_found_in_its_own_room(house: Path) -> None:
    """One map at a time is held. Maps of one photo have vocabularies of little worth, so that the
    right one need not be the first one."""
    order = shelf_order(maps(house), matcher="sift", memory=1)
    with Shelf(order) as shelf, Building(shelf) as building:
        for name in NAMES:
            placed = building.localize(photo(house, name))
            assert placed.map == placed.tried[-1] == name
            assert shelf.held == (name,)
            result = placed.found.result
            assert result is not None
            assert result.cam_from_world is not None
            assert pose_difference(result.cam_from_world, POSE).distance < 0.02
        nowhere = building.localize(photo(house, "elsewhere"))
        assert set(nowhere.tried) == set(NAMES)
        assert nowhere.map == nowhere.tried[0]
        assert not nowhere.found.localized


def test_from_the_command_line(house: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, *others = maps(house)
    also = [word for other in others for word in ("--also", other)]
    common = [first, str(house / "hall.png"), "--camera", CAMERA.colmap_text()]
    common += ["--matcher", "sift", *also]
    assert main(["localize", *common, "--json"]) == 0
    out, err = capsys.readouterr()
    assert "found in hall" in err
    answer = json.loads(out)
    assert answer["map_name"] == answer["maps_tried"][-1] == "hall"
    assert pose_difference(parse_pose(answer["cam_from_world"]), POSE).distance < 0.02
    assert main(["localize", *common, "--memory", "0.001"]) == 0
    assert main(["localize", *common, "--also", first]) == 2
    assert "the same name" in capsys.readouterr().err
    for wrong in (["--prior", "1 0 0 0 0 0 0"], ["--queries", "q.txt"]):
        with pytest.raises(SystemExit):
            main(["localize", *common, *wrong])


def test_references_are_read_without_the_gaussians(house: Path) -> None:
    folder = house / "office.gsmap"
    references, descriptors = open_references(folder)
    whole = open_map(folder)
    assert references.names == whole.references.names
    np.testing.assert_array_equal(descriptors.descriptors, whole.descriptors.descriptors)
    with pytest.raises(MapError, match=r"it has no map\.json"):
        open_references(house)
