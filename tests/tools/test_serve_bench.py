# SPDX-License-Identifier: Apache-2.0
"""The mutated requests of tools/bench_serve.py, and how their answers are judged."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from types import ModuleType
from typing import Any, Callable

import numpy as np
import pytest
from scenes import room_camera

from gscpe.photos import write_image

httpx = pytest.importorskip("httpx")

CAMERA = room_camera(80, 60)


@pytest.fixture
def mutants(tool: Callable[[str], ModuleType]) -> ModuleType:
    return tool("serve_mutants")


def test_mutants_differ_and_come_again(mutants: ModuleType, tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    write_image(tmp_path / "a.png", pixels)

    def made() -> list[tuple[str, bytes]]:
        make = mutants.mutants("http://localhost/", tmp_path / "a.png", CAMERA)
        requests = [make(number) for number in range(60)]
        return [(kind, request.read()) for kind, request in requests]

    first = made()
    assert first == made()
    assert Counter(kind for kind, _ in first) == dict.fromkeys(mutants.KINDS, 10)
    assert len({body for _, body in first}) == 60


def answer(status: int, content: Any, kind: str = "application/json", **headers: str) -> Any:
    return httpx.Response(status, json=content, headers={"content-type": kind, **headers})


def test_verdicts(mutants: ModuleType) -> None:
    problem = "application/problem+json"
    verdict, counts = mutants.verdict_of, mutants.Verdict()
    for reply, expected in (
        (answer(200, {"status": "localized"}), "localized"),
        (answer(200, {"status": "not localized"}), "not localized"),
        (answer(422, {"error": "PhotoError"}, problem), "4xx"),
        (answer(503, {"error": "Busy"}, problem, **{"retry-after": "1"}), "503"),
    ):
        assert verdict(reply) == expected
        counts.add(expected)
    for reply in (
        answer(200, {}),
        answer(422, {"error": "PhotoError"}),
        answer(503, {"error": "Busy"}, problem),
        answer(500, {"error": "Failed"}, problem),
        httpx.Response(400, text="no"),
    ):
        assert verdict(reply).startswith(f"status {reply.status_code}")
        counts.add(verdict(reply))
    assert counts.texts() == ["1", "1", "1", "1", "5"]
