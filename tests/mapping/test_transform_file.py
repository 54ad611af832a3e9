# SPDX-License-Identifier: Apache-2.0
"""Transforms in files: nerfstudio's, and plain matrices."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import random_rotation

from gscpe.errors import SettingsError
from gscpe.mapping import read_transform

RNG = np.random.default_rng(0)
RIGID = np.column_stack([random_rotation(RNG), [1.0, 2.0, 3.0]])


def test_nerfstudios_scale_comes_after_its_transform(tmp_path: Path) -> None:
    path = tmp_path / "dataparser_transforms.json"
    path.write_text(json.dumps({"transform": RIGID.tolist(), "scale": 0.24}))
    point = RNG.normal(size=3)
    expected = 0.24 * (RIGID @ [*point, 1.0])
    np.testing.assert_allclose(read_transform(path).apply(point), expected)


@pytest.mark.parametrize("ending", ["txt", "json"])
@pytest.mark.parametrize("rows", [3, 4])
def test_a_matrix(ending: str, rows: int, tmp_path: Path) -> None:
    matrix = np.vstack([RIGID * np.array([2.0, 2.0, 2.0, 1.0]), [0, 0, 0, 1]])[:rows]
    path = tmp_path / f"matrix.{ending}"
    if ending == "json":
        path.write_text(json.dumps(matrix.tolist()))
    else:
        np.savetxt(path, matrix, header="model to splat", delimiter=", ")
    found = read_transform(path)
    assert found.scale == pytest.approx(2.0)
    np.testing.assert_allclose(found.matrix[:rows], matrix, atol=1e-12)


@pytest.mark.parametrize(
    "text",
    ["", "hello", "{", "{}", '{"transform": [[1, 2], [3, 4]], "scale": 1}', "1 2 3\n4 5 6\n",
     json.dumps({"transform": RIGID.tolist(), "scale": 0}),
     json.dumps({"transform": RIGID.tolist(), "scale": "large"}),
     json.dumps({"transform": (-RIGID).tolist()}), "[[1, 2], [3]]", "5"],
)  # fmt: skip
def test_other_files_are_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    path.write_text(text)
    with pytest.raises(SettingsError, match=r"t\.json is neither nerfstudio's"):
        read_transform(path)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read"):
        read_transform(tmp_path / "none.json")
