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


def test_processes_measure_the_same(
    places: Path,
    tool: Callable[[str], Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Each pair once, whoever measures it; none is begun when the time is up."""
    bench, seen = tool("bench_trust"), []
    for name in ("GSCPE_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    for evidence, *more in (["one.jsonl"], ["two.jsonl", "--jobs", "2"]):
        arguments = [str(places / "places.toml"), "--evidence", str(places / evidence), *more]
        arguments += ["--estimated", "0", "--backend", "cpu"]
        for minutes in ("-1", "9"):
            monkeypatch.setattr(sys, "argv", ["bench_trust.py", *arguments, "--minutes", minutes])
            assert bench.main() == 0
            assert ("Not measured yet: 2 of 2" in capsys.readouterr().out) == (minutes == "-1")
        lines = (json.loads(line) for line in (places / evidence).read_text().splitlines())
        seen.append({
            (line["map"], line["place"]): str(line.get("stages")) for line in lines
        })  # fmt: skip
    assert len(seen[0]) == 2
    assert seen[0] == seen[1]


def test_every_second_photo_is_reported(places: Path, tool: Callable[[str], Any]) -> None:
    """Of those with a true pose, and of the others; by halves, no photo is lost or twice."""
    (places / "here.txt").write_text("".join(f"{i}.png PINHOLE 4 4 4 4 2 2\n" for i in range(24)))
    truth = [f"{i}.png {format_pose(np.eye(4))}\n" for i in range(0, 24, 4)]
    (places / "truth.txt").write_text("".join(truth))
    jobs = tool("trust_jobs")
    read = jobs.read_places(places / "places.toml")
    assert [i for i, half in enumerate(jobs.halves(read[0])) if half == "even"][:6] == [
        0, 1, 3, 6, 8, 9
    ]  # fmt: skip
    whole, *parts = (jobs.jobs_of(read, 99, 99, 99, half) for half in (None, "even", "odd"))
    assert [len([job for job in part if job.place is job.photos]) for part in parts] == [6, 6]
    keys = [job.key for part in parts for job in part]
    assert len(set(keys)) == len(keys)
    assert set(keys) == {job.key for job in whole}
    assert {job.half for job in parts[0]} == {"even"}


def test_more_photos_include_the_fewer(tool: Callable[[str], Any]) -> None:
    spread = tool("trust_jobs").spread
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
