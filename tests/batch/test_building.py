# SPDX-License-Identifier: Apache-2.0
"""A photo looked for in the rooms of a building."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera

from gscpe.batch import (
    Building,
    Instructions,
    OnePhoto,
    Shelf,
    make_crew,
    read_details,
    shelf_order,
)
from gscpe.batch.shelf import map_bytes, shelf_bytes
from gscpe.cli.main import main
from gscpe.errors import MapError, PoseError, SettingsError
from gscpe.geometry import pose_difference, se3
from gscpe.localization import PosePrior
from gscpe.mapping import map_from_rgbd
from gscpe.photos import write_image
from gscpe.poses import read_pose_file
from gscpe.poses.hloc import parse_pose
from gscpe.scene import open_map, save_map
from gscpe.scene.map_folder import open_references
from gscpe.scene.query_list import Query
from gscpe.viewer import contents_of, read_findings

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
    assert "is given twice" in capsys.readouterr().err
    assert main(["localize", *common, "--memory", "-1"]) == 2
    assert "--memory must be positive" in capsys.readouterr().err
    for wrong in (["--prior", "1 0 0 0 0 0 0"], ["--view"]):
        with pytest.raises(SystemExit):
            main(["localize", *common, *wrong])


@pytest.fixture(scope="module")
def listed(house: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The four photos, and one that is missing, localized from the command line; the folder of
    what was written."""
    out = tmp_path_factory.mktemp("listed")
    names = (*NAMES, "elsewhere", "missing")
    (out / "list.txt").write_text("".join(f"{name}.png\n" for name in names))
    assert main(localize_listed(house, out, "--coarse-output", str(out / "coarse.txt"))) == 0
    return out


def localize_listed(house: Path, out: Path, *more: str) -> list[str]:
    first, *others = maps(house)
    words = ["localize", first, *(word for other in others for word in ("--also", other))]
    words += ["--queries", str(out / "list.txt"), "--images", str(house)]
    words += ["--output", str(out / "poses.txt"), "--camera", CAMERA.colmap_text()]
    return [*words, "--matcher", "sift", "--memory", "0.001", *more]


def test_poses_of_a_list_go_to_a_file_of_each_map(house: Path, listed: Path) -> None:
    for name in NAMES:
        for kind in ("poses", "coarse"):
            poses = read_pose_file(listed / f"{kind}.{name}.txt").poses
            assert list(poses) == [f"{name}.png"]
            assert pose_difference(poses[f"{name}.png"], POSE).distance < 0.02
    assert not (listed / "poses.txt").exists()
    details = read_details(listed / "poses.details.jsonl")
    assert [details[f"{name}.png"]["map_name"] for name in NAMES] == list(NAMES)
    assert set(details["elsewhere.png"]["maps_tried"]) == set(NAMES)
    assert details["elsewhere.png"]["status"] == "not localized"
    assert details["missing.png"]["status"] == "failed"
    with pytest.raises(PoseError, match=r"in several maps \(hall, kitchen, office\)"):
        read_pose_file(listed / "poses.details.jsonl")


def test_a_page_shows_the_photos_of_its_map(house: Path, listed: Path) -> None:
    details = listed / "poses.details.jsonl"
    poses = listed / "poses.hall.txt"
    of_hall = read_findings(poses, details, map_name="hall")
    assert {*of_hall.details} - {"elsewhere.png", "missing.png"} == {"hall.png"}
    shown = contents_of(open_map(house / "hall.gsmap"), of_hall)
    assert [camera.name for camera in shown.of_kind("final")] == ["hall.png"]


def test_a_list_goes_on_where_it_was_interrupted(
    house: Path, listed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And is done again where the maps are others."""
    for name in ("list.txt", "poses.details.jsonl"):
        (tmp_path / name).write_bytes((listed / name).read_bytes())
    lines = (tmp_path / "poses.details.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "poses.details.jsonl").write_text("".join(lines[:2]))
    pictures = tmp_path / "pictures"
    more = ["--resume", "--pictures", str(pictures)]
    assert main(localize_listed(house, tmp_path, *more)) == 0
    assert (tmp_path / "poses.details.jsonl").read_text().splitlines(keepends=True)[:2] == lines[:2]
    assert "3 of 5 photos localized" in capsys.readouterr().out
    assert len(list(pictures.iterdir())) == 4
    for name in NAMES:
        same = [folder / f"poses.{name}.txt" for folder in (listed, tmp_path)]
        assert same[0].read_bytes() == same[1].read_bytes()
    fewer = Instructions.of(house / "hall.gsmap", house, matcher="sift", also=maps(house)[:1])
    details = read_details(tmp_path / "poses.details.jsonl")
    assert {detail["map"] for detail in details.values()} != {fewer.fingerprint.map}


def test_processes_find_the_same(house: Path, listed: Path) -> None:
    queries = [Query(f"{name}.png", CAMERA) for name in (*NAMES, "elsewhere")]
    first, *others = maps(house)
    instructions = Instructions.of(first, house, matcher="sift", also=others, memory=1)
    expected = read_details(listed / "poses.details.jsonl")
    with make_crew(instructions, 2) as crew:
        assert "3 maps" in crew.description
        found = {query.name: detail for query, detail in crew.run(queries)}
    assert len(found) == 4
    for name, detail in found.items():
        for key in ("status", "reason", "cam_from_world", "map_name", "maps_tried"):
            assert detail[key] == expected[name][key]


def test_what_several_maps_refuse(house: Path) -> None:
    first, *others = maps(house)
    with pytest.raises(SettingsError, match="priors belong to one map"):
        Instructions.of(first, house, also=others, priors={"a": PosePrior(POSE)})
    with pytest.raises(MapError, match="is given twice"):
        Instructions.of(first, house, also=[first])
    with pytest.raises(MapError, match="have the same name"):
        Instructions.of(first, house, also=[str(house / "elsewhere" / "kitchen.gsmap")])
    order = shelf_order(maps(house), matcher="sift")
    sizes = [map_bytes(folder) for folder in order.folders.values()]
    assert shelf_bytes(order) == sum(sizes)
    assert shelf_bytes(replace(order, memory=1)) == max(sizes)
    assert shelf_bytes(replace(order, memory=10**12)) == sum(sizes)


def test_references_are_read_without_the_gaussians(house: Path) -> None:
    folder = house / "office.gsmap"
    references, descriptors = open_references(folder)
    whole = open_map(folder)
    assert references.names == whole.references.names
    np.testing.assert_array_equal(descriptors.descriptors, whole.descriptors.descriptors)
    with pytest.raises(MapError, match=r"it has no map\.json"):
        open_references(house)
