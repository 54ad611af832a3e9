# SPDX-License-Identifier: Apache-2.0
"""What tools/bench_trust.py measures of photos of two places, and what its report says of them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe.geometry import se3
from gscpe.localization import VerificationSettings
from gscpe.photos import write_image
from gscpe.poses.hloc import format_pose
from gscpe.scene import save_map

PLACES = """
[[place]]
name = "here"
map = "here.gsmap"
images = "here"
queries = "here.txt"
truth = "truth.txt"

[[place]]
name = "elsewhere"
images = "elsewhere"
queries = "elsewhere.txt"
"""


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two rooms, one of them with a map; one of its two photos has a true pose."""
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path / "none"))  # SIFT
    camera = room_camera(240, 180)
    beside = se3.exp([0.03, 0.02, -0.02, 0.01, 0.01, 0.02]) @ ROOM_POSE
    for name, seed in (("here", 0), ("elsewhere", 9)):
        (tmp_path / name).mkdir()
        write_image(tmp_path / name / "a.png", room(seed).shoot(camera, beside).uint8)
    write_image(tmp_path / "here" / "b.png", room(0).shoot(camera, ROOM_POSE).uint8)
    (tmp_path / "here.txt").write_text("".join(f"{n}.png {camera.colmap_text()}\n" for n in "ab"))
    (tmp_path / "elsewhere.txt").write_text(f"a.png {camera.colmap_text()}\n")
    (tmp_path / "truth.txt").write_text(f"a.png {format_pose(beside)}\n")
    save_map(room_map(), tmp_path / "here.gsmap")
    (tmp_path / "places.toml").write_text(PLACES)
    return tmp_path


def test_photos_of_two_places(
    places: Path,
    tool: Callable[[str], Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A photo of the map's place is found, with its errors; one of another is not. What is
    known is not measured again, and a line that was cut off is."""
    evidence = places / "evidence.jsonl"
    bench = tool("bench_trust")

    def run(*more: str) -> str:
        arguments = [str(places / "places.toml"), "--evidence", str(evidence), "--estimated", "0"]
        monkeypatch.setattr(sys, "argv", ["bench_trust.py", *arguments, *more])
        assert bench.main() == 0
        return capsys.readouterr().out

    printed = run()
    own, other = (json.loads(line) for line in evidence.read_text().splitlines())
    assert (own["map"], own["place"], own["name"]) == ("here", "here", "a.png")
    assert own["localized"]
    assert own["stages"]["final"]["error"] < 0.01
    assert (other["place"], other["localized"]) == ("elsewhere", False)
    assert "stages" not in other
    assert len(other["attempts"]) >= 1
    assert "| here | 1 of 1 | 0 | 0 of 0 | 0 | 0 of 1 |" in printed
    assert "| here, cameras given, final | 1 |" in printed
    whole = evidence.read_text()
    assert run() == printed
    assert evidence.read_text() == whole
    evidence.write_text(whole[: len(whole) - 20])
    assert "0 of 0 photos of other places" in run("--report-only")
    assert run() == printed


def test_more_photos_include_the_fewer(tool: Callable[[str], Any]) -> None:
    spread = tool("bench_trust").spread
    for number in (1, 7, 30):
        chosen = spread(100, number)
        assert chosen == spread(100, 60)[:number]
        assert max(np.diff([0, *sorted(chosen), 100])) <= 300 / number
    assert sorted(spread(5, 9)) == [0, 1, 2, 3, 4]


def test_scores_of_matches(tool: Callable[[str], Any]) -> None:
    """The threshold that is nearest decides, and the best attempt counts."""
    report, settings = tool("trust_report"), VerificationSettings()
    poor = {"inliers": 10, "inlier_share": 0.9, "spread": 1.0}
    fair = {"inliers": 400, "inlier_share": 0.75, "spread": 0.5}
    assert report.margin(poor, settings) == 0.5
    assert report.margin(fair, settings) == 1.5
    assert report.best_margin({"attempts": [poor, fair, {}]}, settings) == 1.5
    assert report.best_margin({"attempts": []}, settings) == 0.0
    assert report.area_under_roc([2.0, 3.0], [1.0]) == 1.0
    assert report.area_under_roc([1.0, 3.0], [1.0, 2.0]) == 0.625


def test_normalized_errors_of_what_is_localized(tool: Callable[[str], Any]) -> None:
    stage = {"xi": [0.2, 0, 0, 0, 0, 0.03], "covariance": np.diag([0.01] * 3 + [1e-4] * 3).tolist()}
    lines = [{"localized": True, "stages": {"final": stage}}, {"localized": False, "stages": {}}]
    assert tool("trust_report").normalized_errors(lines, "final") == pytest.approx([13.0])
