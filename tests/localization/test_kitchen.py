# SPDX-License-Identifier: Apache-2.0
"""Real photos in a trained splat: RedKitchen of 7-Scenes, through the command line.

Needs the environment variable GSCPE_DATA (see the ``kitchen`` fixture).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscpe.cli.main import main
from gscpe.geometry import pose_difference
from gscpe.photos import read_image, write_image
from gscpe.poses.hloc import parse_pose, read_poses
from gscpe.scene.query_list import read_query_list

CHOSEN = (5, 30, 55, 80)


@pytest.fixture(scope="module")
def details(kitchen: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """What is said about four queries, and about the first of them mirrored."""
    folder = tmp_path_factory.mktemp("kitchen")
    map_ = folder / "kitchen.gsmap"
    command = ["build-map", str(kitchen / "splat.ply"), "--colmap", str(kitchen / "sparse" / "0")]
    command += ["--images", str(kitchen / "references"), "--output", str(map_)]
    assert main(command) == 0

    queries = read_query_list(kitchen / "queries.txt")
    chosen = [queries[index] for index in CHOSEN]
    lines = []
    for query in chosen:
        image = read_image(kitchen / "queries" / query.name)
        write_image(folder / "photos" / f"{query.name}.png", image)
        lines.append(f"{query.name}.png {query.camera.colmap_text()}\n")
    mirrored = np.ascontiguousarray(read_image(kitchen / "queries" / chosen[0].name)[:, ::-1])
    write_image(folder / "photos" / "mirrored.png", mirrored)
    lines.append(f"mirrored.png {chosen[0].camera.colmap_text()}\n")
    (folder / "queries.txt").write_text("".join(lines))

    command = ["localize", str(map_), "--queries", str(folder / "queries.txt")]
    command += ["--images", str(folder / "photos"), "--output", str(folder / "poses.txt")]
    command += ["--details", str(folder / "details.jsonl")]
    assert main(command) == 0
    found = [json.loads(line) for line in (folder / "details.jsonl").read_text().splitlines()]
    return {detail["name"]: detail for detail in found}


@pytest.mark.parametrize("index", CHOSEN)
def test_within_a_centimetre(index: int, kitchen: Path, details: dict[str, dict[str, Any]]) -> None:
    query = read_query_list(kitchen / "queries.txt")[index]
    detail = details[f"{query.name}.png"]
    assert detail["status"] == "localized", detail["reason"]
    truth = read_poses(kitchen / "truth.txt")[query.name]
    error = pose_difference(parse_pose(detail["cam_from_world"]), truth)
    assert error.distance < 0.01
    assert error.degrees < 0.5


def test_a_mirrored_photo_is_not_localized(details: dict[str, dict[str, Any]]) -> None:
    detail = details["mirrored.png"]
    assert detail["status"] == "not localized"
    assert detail["reason"]
    assert detail["cam_from_world"] is None
