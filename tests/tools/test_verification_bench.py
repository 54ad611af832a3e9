# SPDX-License-Identifier: Apache-2.0
"""What tools/bench_verification.py makes of attempts, and of evidence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import Localizer, LocalizerSettings
from gscpe.geometry import se3
from gscpe.localization import VerificationSettings


@pytest.fixture
def bench(tool: Callable[[str], Any]) -> Any:
    return tool("bench_verification")


def test_evidence_of_photos_right_and_wrong(
    bench: Any, tool: Callable[[str], Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A photo of the room passes all thresholds; one of another room is measured too, and
    does not; a prior beside the truth leads to it."""
    camera = room_camera(240, 180)
    beside = se3.exp([0.03, 0.02, -0.02, 0.01, 0.01, 0.02]) @ ROOM_POSE
    here, elsewhere = (room(seed).shoot(camera, beside).uint8 for seed in (0, 9))
    samples = [
        bench.Sample("RedKitchen", "here.png", camera, lambda: here, beside),
        bench.Sample("scikit-image", "elsewhere.png", camera, lambda: elsewhere),
        bench.Sample(bench.TRACKING, "d.png", camera, lambda: here, beside),
    ]
    settings = LocalizerSettings(hypotheses=1, verification=bench.NO_THRESHOLDS)
    path = tmp_path / "evidence.jsonl"
    with Localizer(room_map(), settings, "sift") as localizer:
        bench.measure(localizer, samples, path)
    lines = bench.read_evidence(path)
    assert list(lines) == [(sample.kind, sample.name) for sample in samples]
    (right,), (wrong,), (tracked,) = (line["attempts"] for line in lines.values())
    report = tool("verification_report")
    thresholds = VerificationSettings()
    assert all(criterion.accepts(right, thresholds) for criterion in report.CRITERIA)
    assert not all(criterion.accepts(wrong, thresholds) for criterion in report.CRITERIA)
    assert right["error"] < 0.01
    assert "error" not in wrong
    assert tracked["error"] < 0.01
    report.print_report(list(lines.values()), thresholds)
    printed = capsys.readouterr().out
    assert "| RedKitchen | 1 | 1 | 0 |" in printed
    assert "| scikit-image | 1 | 0 | 0 |" in printed


def test_what_is_better_scores_higher(tool: Callable[[str], Any]) -> None:
    report = tool("verification_report")
    by_name = {criterion.evidence: criterion for criterion in report.CRITERIA}
    attempts = json.loads('[{"inliers": 5, "shift": 0.5}, {"inliers": 90, "shift": 0.01}, {}]')
    for name in ("inliers", "shift"):
        scores = by_name[name].scores(attempts)
        assert scores[1] > scores[0] > scores[2] == -np.inf
    assert [by_name["shift"].text(s) for s in by_name["shift"].scores(attempts)] == [
        "0.5", "0.01", "none",
    ]  # fmt: skip
