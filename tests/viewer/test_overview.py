# SPDX-License-Identifier: Apache-2.0
"""The picture without a browser: what is in it, and the command that writes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room_map

from gscpe.cli.main import main
from gscpe.errors import SettingsError
from gscpe.geometry import se3
from gscpe.photos import read_image
from gscpe.poses import write_pose_file
from gscpe.scene import save_map
from gscpe.viewer import Findings, OverviewSettings, contents_of, overview
from gscpe.viewer.cameras import COLOURS

POSES = {f"{i}.png": se3.exp([0.1 * i - 0.2, 0, 0.1, 0, 0.05 * i, 0]) @ ROOM_POSE for i in range(4)}


def test_what_is_known_is_drawn() -> None:
    settings = OverviewSettings(320, 200)
    bare = overview(room_map(), contents_of(room_map()), settings)
    found = Findings(poses=POSES, truth={"0.png": POSES["0.png"]}, trajectory={0.0: ROOM_POSE})
    full = overview(room_map(), contents_of(room_map(), found), settings)
    assert full.shape[1:] == (320, 3)
    assert full.shape[0] > bare.shape[0] > 200  # more rows of the legend

    def pixels(picture: NDArray[np.uint8], colour: tuple[int, int, int]) -> int:
        return int(np.sum(np.abs(picture.astype(int) - colour).max(axis=2) < 12))

    assert pixels(full, COLOURS["final"]) > pixels(bare, COLOURS["final"]) + 50
    assert pixels(full, COLOURS["truth"]) > pixels(bare, COLOURS["truth"]) + 20
    assert bare[:200].std() > 10  # the room itself
    with pytest.raises(SettingsError):
        OverviewSettings(10, 10)


def test_the_command_writes_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_map(room_map(), tmp_path / "room.gsmap")
    write_pose_file(tmp_path / "poses.txt", POSES, "hloc")
    words = ["view", str(tmp_path / "room.gsmap"), "--poses", str(tmp_path / "poses.txt")]
    assert main([*words, "--screenshot", str(tmp_path / "view.png")]) == 0
    assert read_image(tmp_path / "view.png").shape[1:] == (1280, 3)
    assert "5 cameras" in capsys.readouterr().out
    for wrong in (
        ("--screenshot", str(tmp_path)),
        ("--screenshot", str(tmp_path / "poses.txt")),
        ("--truth", str(tmp_path / "missing.txt"), "--screenshot", str(tmp_path / "new.png")),
    ):
        assert main([*words, *wrong]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 3
    assert not (tmp_path / "new.png").exists()


def test_a_map_may_have_any_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also one that ``gscpe serve`` could make no address of."""
    save_map(room_map(), tmp_path / "it's @ home (2).gsmap")
    map_, picture = str(tmp_path / "it's @ home (2).gsmap"), tmp_path / "view.png"
    assert main(["view", map_, "--screenshot", str(picture)]) == 0
    assert "the map with 1 camera\n" in capsys.readouterr().out
