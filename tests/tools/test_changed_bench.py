# SPDX-License-Identifier: Apache-2.0
"""What tools/bench_changed.py measures of a photo that is changed, and prints."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe.geometry import se3
from gscpe.photos import write_image
from gscpe.poses.hloc import format_pose
from gscpe.scene import save_map

Tool = Callable[[str], Any]


def test_a_photo_and_its_changes(
    tmp_path: Path,
    tool: Tool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path / "none"))  # SIFT
    camera = room_camera(240, 180)
    truth = se3.exp([0.03, 0.02, -0.02, 0.01, 0.01, 0.02]) @ ROOM_POSE
    write_image(tmp_path / "a.png", room().shoot(camera, truth).uint8)
    (tmp_path / "list.txt").write_text(f"a.png {camera.colmap_text()}\n")
    (tmp_path / "truth.txt").write_text(f"a.png {format_pose(truth)}\n")
    save_map(room_map(), tmp_path / "room.gsmap")
    evidence = tmp_path / "evidence.jsonl"
    arguments = [
        *("bench_changed.py", str(tmp_path / "room.gsmap"), "--only", "x 2", "half"),
        *("--images", str(tmp_path), "--list", str(tmp_path / "list.txt")),
        *("--truth", str(tmp_path / "truth.txt"), "--evidence", str(evidence)),
    ]
    monkeypatch.setattr(sys, "argv", arguments)
    assert tool("bench_changed").main() == 0
    found = [json.loads(line) for line in evidence.read_text().splitlines()]
    assert [each["change"] for each in found] == ["unchanged", "exposure x 2, clipped"]
    for each in found:
        assert each["localized"], each["reason"]
        assert each["photo"] == "a.png"
        assert each["centimetres"] < 1.0
        assert each["seconds"] > 0
    printed = capsys.readouterr().out
    assert printed.startswith("1 photos.")
    assert "| unchanged | 1 of 1 | 0 |" in printed
    ratio = found[1]["centimetres"] / found[0]["centimetres"]
    assert f"| {ratio:.2f} / " in printed


def test_the_table_counts_what_is_lost_and_what_is_wrong(
    tool: Tool, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = tool("bench_changed")
    nan = float("nan")
    right = bench.Found("a", "unchanged", True, 0.2, 0.05, 0.3, 0.2, 6.0, 1.5, 1, "", "", 2.0)
    twice = replace(right, photo="b", centimetres=0.4, degrees=0.1, normalized=20.0, seconds=4.0)
    astray = replace(right, change="dark", centimetres=8.0, normalized=400.0, sigmas=9.0)
    lost = bench.Found("b", "dark", False, *[nan] * 6, 5, "", "why", 30.0)
    all_lost = [replace(lost, change="black", photo=name) for name in "ab"]
    bench.report([right, twice, astray, lost, *all_lost], ["unchanged", "dark", "black"])
    rows = {
        row[1]: row[2:]
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("|") and (row := [cell.strip() for cell in line.split("|")])
    }
    assert rows["unchanged"][:2] == ["2 of 2", "0"]
    assert rows["unchanged"][4:9] == [
        *("0.300 cm / 0.075°", "1.00 / 1.00", f"{np.sqrt(0.1):.3f}", "13.0 / 13.0", "50%")
    ]
    assert rows["dark"][:2] == ["1 of 2", "1"]
    assert rows["dark"][5] == f"{8.0 / 0.3:.2f} / {0.05 / 0.075:.2f}"
    assert rows["dark"][9:11] == ["9.0", "5.33 / 5.33"]
    assert rows["black"] == ["0 of 2", "0", *[""] * 8, "10.00 / 10.00", ""]
