# SPDX-License-Identifier: Apache-2.0
"""Damaged files that still parse: absurd numbers are refused, or rendered without a crash."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import random_scene, simple_camera, splat_columns, splat_table, write_table

from gscpe.errors import SplatError
from gscpe.render import Renderer
from gscpe.splats import read_splat

LOG_1E30, LOG_9E14 = float(np.log(1e30)), float(np.log(9e14))
CHANGES = [
    ({"x": 1e30, "y": -1e30, "z": 1e30}, 3),
    ({"x": 9e14, "y": -9e14, "z": 9e14}, 3),
    ({"z": 9e14}, 3),
    (dict.fromkeys(("scale_0", "scale_1", "scale_2"), LOG_9E14), 3),
    ({"z": 9e14, "scale_0": LOG_9E14, "scale_1": LOG_9E14}, 3),
    ({"z": 9e14, "scale_0": LOG_9E14, "scale_1": LOG_9E14}, 20),
    ({"scale_0": LOG_9E14, "scale_1": -80.0}, 3),
    ({"f_dc_0": 9e14, "f_dc_1": -9e14, "f_rest_3": 9e14}, 3),
    ({"z": 1e38}, 3),
    ({"x": 3e38, "y": 3e38, "z": 3e38}, 3),
    (dict.fromkeys(("scale_0", "scale_1", "scale_2"), LOG_1E30), 3),
    (dict.fromkeys(("scale_0", "scale_1", "scale_2"), 88.7), 3),
    ({"scale_0": LOG_1E30, "scale_1": -80.0}, 3),
    (dict.fromkeys(("scale_0", "scale_1", "scale_2"), -80.0), 20),
    ({"scale_0": LOG_1E30, "x": 1e30}, 20),
    ({"x": 1e30, "y": 1e30, "z": 1e30}, 20),
    ({"f_dc_0": 1e30, "f_dc_1": -1e30, "f_rest_3": 3e38}, 3),
    ({"opacity": 1e30}, 20),
    ({"opacity": -1e30}, 20),
    ({"rot_0": 1e-30, "rot_1": 0.0, "rot_2": 0.0, "rot_3": 1e-38}, 20),
]


@pytest.mark.parametrize(("values", "count"), CHANGES)
def test_absurd_numbers(
    values: dict[str, float], count: int, backend: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    scene = random_scene(rng, 20, 1)
    table = splat_table(scene)
    for column, value in values.items():
        table[:count, splat_columns(1).index(column)] = value
    write_table(tmp_path / "a.ply", splat_columns(1), table)
    try:
        scene = read_splat(tmp_path / "a.ply")
    except SplatError as error:
        assert "a.ply" in str(error)
        return
    with Renderer(scene, backend) as renderer:
        view = renderer.render(simple_camera(), np.eye(4))
    assert np.all((view.opacity >= 0) & (view.opacity <= 1.0001))
    assert not np.any(np.isnan(view.rgb)) and not np.any(np.isnan(view.depth))
