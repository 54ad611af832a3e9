# SPDX-License-Identifier: Apache-2.0
"""Rows of a ``.ply`` that hold what no trainer means: mended, left out, or refused."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import random_scene, splat_columns, splat_table, write_table
from splat_checks import ENCODINGS, assert_refused, assert_valid

from gscpe import splats
from gscpe.errors import SplatError
from gscpe.splats import GaussianScene, read_splat


@pytest.fixture
def scene(rng: np.random.Generator) -> GaussianScene:
    return random_scene(rng, 20, 1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "kitchen splat.ply"


def test_quaternions_of_any_length_are_normalized(path: Path, scene: GaussianScene) -> None:
    table = splat_table(scene)
    table[:, -4:] *= np.geomspace(1e-3, 1e3, len(table))[:, None]
    table[0, -4:] = 0.0
    write_table(path, splat_columns(1), table)
    again = read_splat(path)
    np.testing.assert_allclose(again.quaternions[1:], scene.quaternions[1:], atol=1e-6)
    np.testing.assert_array_equal(again.quaternions[0], [1, 0, 0, 0])


@pytest.mark.parametrize("value", [1e25, 3e38])
def test_huge_quaternions_are_normalized_or_refused(
    value: float, path: Path, scene: GaussianScene
) -> None:
    table = splat_table(scene)
    table[3, -2] = value
    write_table(path, splat_columns(1), table)
    try:
        again = read_splat(path)
    except SplatError as error:
        assert str(path) in str(error)
    else:
        assert_valid(again)


def test_infinite_logits_are_opaque_and_transparent(path: Path, scene: GaussianScene) -> None:
    """Converters from 8-bit formats write them; the opacity itself is an honest 1 or 0."""
    table = splat_table(scene)
    column = splat_columns(1).index("opacity")
    table[0, column], table[1, column] = np.inf, -np.inf
    write_table(path, splat_columns(1), table)
    assert read_splat(path).opacities[:2].tolist() == [1.0, 0.0]


NOT_FINITE = [
    (column, value)
    for column in ("x", "z", "f_dc_0", "f_rest_8", "scale_1", "rot_3")
    for value in (np.nan, np.inf, -np.inf)
]


def assert_left_out(
    path: Path, rows: list[int], scene: GaussianScene, caplog: pytest.LogCaptureFixture, *words: str
) -> None:
    """All but these rows come back, and a warning counts them and says these words."""
    with caplog.at_level(logging.WARNING):
        again = read_splat(path)
    assert_valid(again)
    np.testing.assert_array_equal(again.means, np.delete(scene.means, rows, axis=0))
    for word in (str(path), f"{len(rows)} of {len(scene)} Gaussians are left out", *words):
        assert word in caplog.text


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("column", "value"), [*NOT_FINITE, ("opacity", np.nan)])
def test_a_row_that_is_not_finite_is_left_out(
    column: str,
    value: float,
    encoding: str,
    path: Path,
    scene: GaussianScene,
    caplog: pytest.LogCaptureFixture,
) -> None:
    table = splat_table(scene)
    table[7, splat_columns(1).index(column)] = value
    write_table(path, splat_columns(1), table, encoding=encoding)
    if column == "scale_1" and value < 0:  # exp(-inf) = 0: flat, not damaged
        assert_valid(read_splat(path))
        return
    assert_left_out(path, [7], scene, caplog, "1 hold NaN or infinite values")


def test_rows_of_zeros_are_left_out(
    path: Path, scene: GaussianScene, caplog: pytest.LogCaptureFixture
) -> None:
    """Grey balls of a unit's size at the origin, otherwise; a zero quaternion alone is none."""
    table = splat_table(scene)
    table[3:6] = 0.0
    table[8, -4:] = 0.0
    write_table(path, splat_columns(1), table)
    assert_left_out(path, [3, 4, 5], scene, caplog, "3 are all zeros")


def test_rows_of_zeros_far_from_the_origin(
    path: Path, scene: GaussianScene, caplog: pytest.LogCaptureFixture
) -> None:
    """Zero in the file, where no Gaussian is, and not relative to the scene's origin."""
    origin = np.array([5e5, 5.4e6, 0.0])
    splats.write_splat(replace(scene, origin=origin), path)
    table = np.frombuffer(path.read_bytes().split(b"end_header\n", 1)[1], np.uint8).reshape(20, -1)
    spoilt = table.copy()
    spoilt[4:6] = 0
    path.write_bytes(path.read_bytes().replace(table.tobytes(), spoilt.tobytes()))
    with caplog.at_level(logging.WARNING):
        again = read_splat(path)
    assert "2 of 20 Gaussians are left out: 2 are all zeros" in caplog.text
    world = np.delete(scene.means, [4, 5], axis=0) + origin
    np.testing.assert_allclose(again.means + again.origin, world, atol=1e-6)


def test_absurd_values_are_left_out(
    path: Path, scene: GaussianScene, caplog: pytest.LogCaptureFixture
) -> None:
    table = splat_table(scene)
    table[7, splat_columns(1).index("scale_0")] = 100.0  # beyond single precision
    table[8, splat_columns(1).index("y")] = -3e15
    write_table(path, splat_columns(1), table)
    assert_left_out(path, [7, 8], scene, caplog, "1 hold NaN or inf", "1 hold values beyond 1e+15")


@pytest.mark.parametrize("bad", [11, 20])
@pytest.mark.parametrize("value", [np.nan, 0.0])
def test_mostly_bad_rows_are_refused(
    value: float, bad: int, path: Path, scene: GaussianScene
) -> None:
    table = splat_table(scene)
    table[:bad] = value
    write_table(path, splat_columns(1), table)
    assert_refused(path, f"{bad} of 20 Gaussians cannot be used", "damaged")


def test_flat_gaussians_get_a_little_thickness(
    path: Path, scene: GaussianScene, caplog: pytest.LogCaptureFixture
) -> None:
    """A log scale of -inf, or of too little for float32; without any size, it is left out."""
    table = splat_table(scene)
    first = splat_columns(1).index("scale_0")
    table[2, first + 1] = -np.inf
    table[4, first : first + 2] = -np.inf, -200.0
    table[6, first : first + 3] = -np.inf
    write_table(path, splat_columns(1), table)
    assert_left_out(path, [6], scene, caplog, "1 have no size", "2 of 20 Gaussians are flat")
    again = read_splat(path)
    thin = 1e-3 * np.delete(scene.scales[2], 1).min()
    np.testing.assert_allclose(again.scales[2, 1], thin, rtol=1e-5)
    np.testing.assert_allclose(again.scales[4, :2], 1e-3 * scene.scales[4, 2], rtol=1e-5)
    untouched = [i for i in range(20) if i not in (2, 4, 6)]
    kept = [i - (i > 6) for i in untouched]
    np.testing.assert_allclose(again.scales[kept], scene.scales[untouched], rtol=1e-5)


def test_surfels_of_two_scales(
    path: Path, scene: GaussianScene, caplog: pytest.LogCaptureFixture
) -> None:
    """2D Gaussian Splatting: flat along the third axis."""
    columns = splat_columns(1)
    keep = [i for i, name in enumerate(columns) if name != "scale_2"]
    write_table(path, [columns[i] for i in keep], splat_table(scene)[:, keep])
    with caplog.at_level(logging.WARNING):
        again = read_splat(path)
    assert "2D Gaussian Splatting" in caplog.text
    assert_valid(again)
    np.testing.assert_allclose(again.scales[:, :2], scene.scales[:, :2], rtol=1e-6)
    thin = 1e-3 * scene.scales[:, :2].min(axis=1)
    np.testing.assert_allclose(again.scales[:, 2], thin, rtol=1e-5)


@pytest.mark.parametrize("degree", [4, 5])
def test_harmonics_beyond_degree_3_are_cut(
    degree: int, path: Path, rng: np.random.Generator, caplog: pytest.LogCaptureFixture
) -> None:
    scene = random_scene(rng, 20, 3)
    rest = (degree + 1) ** 2 - 1
    table, columns = splat_table(scene), splat_columns(degree)
    wide = rng.normal(size=(20, 3, rest)).astype(np.float32)  # colour by colour
    wide[:, :, :15] = table[:, 9:54].reshape(20, 3, 15)
    wide_table = np.concatenate([table[:, :9], wide.reshape(20, -1), table[:, 54:]], axis=1)
    write_table(path, columns, wide_table)
    with caplog.at_level(logging.WARNING):
        again = read_splat(path)
    assert f"degree {degree} are cut to degree 3" in caplog.text
    np.testing.assert_array_equal(again.sh, scene.sh)
