# SPDX-License-Identifier: Apache-2.0
"""What tools/bench_changed.py measures of a photo that is changed, and prints."""

from __future__ import annotations

import json
import re
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


@pytest.fixture
def arguments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Of the command, for a room with a map and three photos."""
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path / "none"))  # SIFT
    camera = room_camera(240, 180)
    listed, poses = [], []
    for name, shift in (("a", 0.03), ("b", -0.02), ("c", 0.0)):
        truth = se3.exp([shift, 0.02, -0.02, 0.01, 0.01, 0.02]) @ ROOM_POSE
        write_image(tmp_path / f"{name}.png", room().shoot(camera, truth).uint8)
        listed.append(f"{name}.png {camera.colmap_text()}\n")
        poses.append(f"{name}.png {format_pose(truth)}\n")
    (tmp_path / "list.txt").write_text("".join(listed))
    (tmp_path / "truth.txt").write_text("".join(poses))
    save_map(room_map(), tmp_path / "room.gsmap")
    return [
        *("bench_changed.py", str(tmp_path / "room.gsmap"), "--only", "x 2", "50%"),
        *("--images", str(tmp_path), "--list", str(tmp_path / "list.txt")),
        *("--truth", str(tmp_path / "truth.txt"), "--evidence", str(tmp_path / "evidence.jsonl")),
    ]


def test_photos_and_their_changes(
    arguments: list[str],
    tool: Tool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The costly change is made of one photo alone. A run that was cut off goes on."""
    bench, evidence = tool("bench_changed"), Path(arguments[-1])
    monkeypatch.setattr(sys, "argv", [*arguments, "--queries", "1"])
    assert bench.main() == 0
    found = [json.loads(line) for line in evidence.read_text().splitlines()]
    changes = ["unchanged", "exposure x 2, clipped", "50% replaced"]
    assert [each["change"] for each in found] == changes
    for each in found[:2]:
        assert each["localized"], each["reason"]
        assert each["photo"] == "a.png"
        assert each["centimetres"] < 1.0
        assert each["seconds"] > 0
    printed = capsys.readouterr().out
    assert printed.startswith("1 photos.")
    assert "| unchanged | 1 of 1 | 0 |" in printed
    ratio = found[1]["centimetres"] / found[0]["centimetres"]
    assert f"| {ratio:.2f} | " in printed

    kept = evidence.read_text().splitlines()[:2]
    evidence.write_text("\n".join(kept) + '\n{"photo": "a')
    monkeypatch.setattr(sys, "argv", [*arguments, "--queries", "2", "--costly", "1"])
    assert bench.main() == 0
    lines = evidence.read_text().splitlines()
    assert lines[:2] == kept
    again = [json.loads(line) for line in lines[3:]]
    measured = [(each["photo"], each["change"]) for each in again]
    second = measured[-1][0]
    assert second != "a.png"
    assert measured == [("a.png", changes[2]), *((second, change) for change in changes[:2])]
    assert "| 50% replaced |" in capsys.readouterr().out

    monkeypatch.setattr(sys, "argv", [*arguments, "--queries", "3", "--report-only"])
    assert bench.main() == 0
    assert capsys.readouterr().out.startswith("2 photos.")
    assert evidence.read_text().splitlines() == lines


def test_evidence_of_other_seeds_does_not_count(
    arguments: list[str],
    tool: Tool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for seed in ("0", "0", "1"):
        monkeypatch.setattr(sys, "argv", [*arguments, "--queries", "1", "--seed", seed])
        assert tool("bench_changed").main() == 0
    lines = [json.loads(line) for line in Path(arguments[-1]).read_text().splitlines()]
    assert [line["which"] for line in lines] == [
        f"queries in room.gsmap, seed {seed}" for seed in "000111"
    ]
    assert capsys.readouterr().out.count("| unchanged | 1 of 1 |") == 3


def test_halves_have_no_photo_in_common(arguments: list[str], tool: Tool) -> None:
    bench = tool("bench_changed")
    folder = Path(arguments[-1]).parent
    files = [str(folder / name) for name in ("list.txt", "truth.txt")]

    def names(half: str | None) -> set[str]:
        photos = bench.Photos(arguments[1], str(folder), *files, half=half)
        return {name for _, name, _ in bench.jobs_of(photos, 9, 9, ["unchanged"])}

    assert names("odd") == {"b.png"}
    assert names("even") == {"a.png", "c.png"}
    assert names(None) == {"a.png", "b.png", "c.png"}


@pytest.mark.parametrize("change", ["50% replaced", "three people", "furniture moved"])
def test_another_seed_changes_other_parts(change: str, tool: Tool) -> None:
    photos = tool("changed_photos")
    image = room().shoot(room_camera(120, 90), ROOM_POSE).uint8
    first, second = (photos.changed(image, change, seed) for seed in (0, 1))
    np.testing.assert_array_equal(first, photos.CHANGES[change](image))
    np.testing.assert_array_equal(second, photos.changed(image, change, 1))
    moved, also = ((each != image).any(axis=2) for each in (first, second))
    assert np.mean(moved != also) > 0.05


def test_the_table_counts_what_is_lost_and_what_is_wrong(
    tool: Tool, capsys: pytest.CaptureFixture[str]
) -> None:
    reported = tool("changed_report")
    nan = float("nan")
    right = reported.Found("a", "unchanged", True, 0.2, 0.05, 0.3, 0.2, 6.0, 1.5, 1, "", "", 2.0)
    twice = replace(right, photo="b", centimetres=0.4, degrees=0.1, normalized=20.0, seconds=4.0)
    astray = replace(right, change="dark", centimetres=8.0, normalized=400.0, sigmas=9.0)
    lost = reported.Found("b", "dark", False, *[nan] * 6, 5, "", "why", 30.0)
    all_lost = [replace(lost, change="black", photo=name) for name in "ab"]
    reported.report([right, twice, astray, lost, *all_lost], ["unchanged", "dark", "black", "red"])
    printed = capsys.readouterr().out
    rows = {
        row[1]: row[2:-1]
        for line in printed.splitlines()
        if line.startswith("|") and (row := [cell.strip() for cell in line.split("|")])
    }
    assert rows["unchanged"] == [
        *("2 of 2", "0", "0.300 cm / 0.075°", "1.00", "1.00", f"{np.sqrt(0.1):.3f}"),
        *("13.0 / 13.0", "50%", "1.5", "1.00 / 1.00"),
    ]
    assert rows["dark"][:2] == ["1 of 2", "1"]
    assert rows["dark"][3:5] == ["40.00", "1.00"]  # to the same photo
    assert rows["dark"][8:] == ["9.0", "5.33 / 5.33"]
    assert rows["black"] == ["0 of 2", "0", *[""] * 7, "10.00 / 10.00"]
    assert "red" not in rows
    assert "- dark, b: why" in printed.splitlines()


def test_the_interval_holds_the_ratio_where_errors_scatter(
    tool: Tool, capsys: pytest.CaptureFixture[str], rng: np.random.Generator
) -> None:
    """A change makes errors 1.5 times as large, but for chance, which is that of 40 photos."""
    reported, nan = tool("changed_report"), float("nan")
    found = []
    for i, errors in enumerate(np.exp(0.5 * rng.normal(size=(40, 2, 2)))):
        for change, (cm, degrees) in zip(("unchanged", "dark"), errors, strict=True):
            larger = 1.5 if change == "dark" else 1.0
            found.append(
                reported.Found(
                    *(str(i), change, True, larger * cm, larger * degrees, nan, nan),
                    *(6.0, 1.0, 1, "", "", 1.0),
                )
            )
    reported.report(found, ["unchanged", "dark"])
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("| dark"))
    for cell in row.split(" | ")[4:6]:
        ratio, lower, upper = (float(each) for each in re.findall(r"[\d.]+", cell))
        assert lower < 1.5 < upper
        assert lower < ratio < upper
        assert 1.3 < upper / lower < 2.5
