# SPDX-License-Identifier: Apache-2.0
"""``gscpe localize --queries --priors``: where each photo probably was taken."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import PoseError, PosePrior, Query, save_map, write_image, write_pose_file
from gscpe.batch import Instructions, read_priors
from gscpe.batch.priors import with_priors
from gscpe.cli.main import main
from gscpe.geometry import pose_difference, se3
from gscpe.mapping import map_without_references
from gscpe.poses import read_pose_file

CAMERA = room_camera(240, 180)
POSES = {
    "a.png": np.asarray(se3.exp([0.05, -0.03, 0.04, 0.02, -0.02, 0.03]) @ ROOM_POSE),
    "b.png": np.asarray(se3.exp([-0.04, 0.02, 0.05, -0.02, 0.03, 0.0]) @ ROOM_POSE),
}
NEAR = {name: np.asarray(se3.exp([0.02, 0, 0, 0, 0.01, 0]) @ pose) for name, pose in POSES.items()}
QUERIES = [Query(name, CAMERA) for name in POSES]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("priors")
    save_map(room_map(), folder / "room.gsmap")
    save_map(map_without_references(room_map().scene), folder / "alone.gsmap")
    for name, pose in POSES.items():
        write_image(folder / "photos" / name, room().shoot(CAMERA, pose).uint8)
    lines = [f"{name} {CAMERA.colmap_text()}\n" for name in POSES]
    (folder / "queries.txt").write_text("".join(lines))
    write_pose_file(folder / "both.txt", NEAR, "hloc")
    write_pose_file(folder / "one.json", {"b.png": NEAR["b.png"]}, "json")
    write_pose_file(folder / "others.txt", {"other.png": NEAR["b.png"]}, "hloc")
    return folder


def localize(folder: Path, output: Path, map_name: str, *more: str) -> int:
    return main(
        [
            *("localize", str(folder / map_name), "--queries", str(folder / "queries.txt")),
            *("--images", str(folder / "photos"), "--output", str(output), *more),
        ]
    )


def starts(output: Path) -> dict[str, Any]:
    lines = output.with_suffix(".details.jsonl").read_text().splitlines()
    return {detail["name"]: detail["started_from"] for detail in map(json.loads, lines)}


def test_photos_with_a_prior_begin_there(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "poses.txt"
    assert localize(folder, output, "room.gsmap", "--priors", str(folder / "one.json")) == 0
    assert "1 of 2 photos have a prior" in capsys.readouterr().err
    assert starts(output) == {"a.png": "reference", "b.png": "tracking"}
    unsure = ("--priors", str(folder / "both.txt"), "--prior-sigma", "0.5", "20", "--resume")
    assert localize(folder, output, "room.gsmap", *unsure) == 0
    assert "localizing 2 photos again" in capsys.readouterr().err  # other priors, other answers
    assert starts(output) == {"a.png": "prior", "b.png": "prior"}
    assert localize(folder, output, "room.gsmap", *unsure) == 0
    for name, pose in read_pose_file(output).poses.items():
        error = pose_difference(pose, POSES[name])
        assert error.distance < 4e-3 and error.degrees < 0.1


def test_a_map_without_references_is_enough(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "poses.txt"
    more = ("--priors", str(folder / "both.txt"), "--workers", "2")
    assert localize(folder, output, "alone.gsmap", *more) == 0
    assert starts(output) == {"a.png": "tracking", "b.png": "tracking"}
    assert localize(folder, tmp_path / "none.txt", "alone.gsmap") == 2


def test_priors_that_fit_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "poses.txt"
    others = ("--priors", str(folder / "others.txt"))
    assert localize(folder, output, "room.gsmap", *others) == 2
    assert "names must match" in capsys.readouterr().err
    assert not output.exists()
    one = ("--priors", str(folder / "one.json"))
    assert localize(folder, output, "room.gsmap", *one, "--prior-sigma", "-1", "2") == 2
    with pytest.raises(SystemExit):
        localize(folder, output, "room.gsmap", "--prior-sigma", "1", "2")
    with pytest.raises(SystemExit):
        main(["localize", str(folder / "room.gsmap"), "photo.jpg", *one])
    with pytest.raises(PoseError, match="no pose for any photo"):
        read_priors(folder / "others.txt", QUERIES)


def test_the_fingerprint_knows_each_prior(folder: Path) -> None:
    before = Instructions.of(folder / "room.gsmap", folder / "photos").fingerprint.settings
    marks = {before, with_priors(before, {})}
    assert len(marks) == 1
    for priors in (
        {"a.png": PosePrior(NEAR["a.png"])},
        {"b.png": PosePrior(NEAR["a.png"])},
        {"a.png": PosePrior(NEAR["b.png"])},
        {"a.png": PosePrior(NEAR["a.png"], 0.1)},
        {"a.png": PosePrior(NEAR["a.png"], 0.05, 3.0)},
    ):
        instructions = Instructions.of(folder / "room.gsmap", folder / "photos", priors=priors)
        marks.add(instructions.fingerprint.settings)
        sent = pickle.loads(pickle.dumps(instructions))  # as workers get it
        (name,) = priors
        np.testing.assert_array_equal(sent.priors[name].cam_from_world, priors[name].cam_from_world)
    assert len(marks) == 6
