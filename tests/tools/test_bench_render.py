# SPDX-License-Identifier: Apache-2.0
"""The scenes of tools/bench_render.py grow, and are drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from helpers import random_scene


@pytest.fixture
def bench(tool: Callable[[str], Any]) -> Any:
    return tool("bench_render")


@pytest.mark.parametrize("count", [50, 100, 730])
def test_tiled_scenes_have_the_count(count: int, bench: Any, rng: np.random.Generator) -> None:
    scene = random_scene(rng, 100, 1)
    larger = bench.tiled(scene, count)
    assert len(larger) == count
    assert len(np.unique(larger.means, axis=0)) == count


def test_plot(bench: Any, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    cases = {
        (count, backend): bench.Case(count / 1e4, count, 100.0)
        for count in bench.COUNTS
        for backend in ("cpu", "gl")
    }
    sizes = {size: {"gl": size[0] / 2, "cpu": size[0] / 9} for size in bench.SIZES}
    bench.plot(cases, sizes, tmp_path / "images" / "growth.png")
    data = (tmp_path / "images" / "growth.png").read_bytes()
    assert data.startswith(b"\x89PNG")
    assert len(data) < 80_000
