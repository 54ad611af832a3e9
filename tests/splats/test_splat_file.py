# SPDX-License-Identifier: Apache-2.0
"""Reading 3DGS ``.ply`` files: what is stored comes back, and damage is named."""

from __future__ import annotations

import gzip
import logging
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import random_scene, splat_columns, splat_header, splat_table, write_splat, write_table

from gscpe import splats
from gscpe.errors import SplatError
from gscpe.splats import GaussianScene, read_splat

ENCODINGS = ("binary_little_endian", "binary_big_endian", "ascii")


@pytest.fixture
def scene(rng: np.random.Generator) -> GaussianScene:
    return random_scene(rng, 20, 1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "kitchen splat.ply"


def assert_refused(path: Path, *words: str) -> None:
    """It must be a SplatError, name the file, and say these words."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SplatError) as caught:
            read_splat(path)
    for word in (str(path), *words):
        assert word in str(caught.value)


def assert_valid(scene: GaussianScene) -> None:
    """The bounds that GaussianScene documents."""
    for name in ("means", "quaternions", "scales", "opacities", "sh"):
        array = getattr(scene, name)
        assert array.dtype == np.float32
        assert len(array) == len(scene) > 0
        assert np.all(np.isfinite(array)), name
    lengths = np.linalg.norm(scene.quaternions.astype(np.float64), axis=1)
    np.testing.assert_allclose(lengths, 1.0, atol=1e-5)
    assert np.all(scene.scales > 0)
    assert np.all((scene.opacities >= 0) & (scene.opacities <= 1))


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_round_trip(degree: int, encoding: str, path: Path, rng: np.random.Generator) -> None:
    scene = random_scene(rng, 30, degree)
    write_splat(path, scene, encoding=encoding)
    again = read_splat(path)
    assert_valid(again)
    assert again.sh_degree == degree
    assert not again.antialiased
    np.testing.assert_array_equal(again.means, scene.means)
    np.testing.assert_array_equal(again.sh, scene.sh)
    np.testing.assert_allclose(again.scales, scene.scales, rtol=1e-6)
    np.testing.assert_allclose(again.opacities, scene.opacities, rtol=1e-5)
    np.testing.assert_allclose(again.quaternions, scene.quaternions, atol=1e-6)


def test_one_gaussian(path: Path, rng: np.random.Generator) -> None:
    for encoding in ENCODINGS:
        write_splat(path, random_scene(rng, 1, 0), encoding=encoding)
        assert len(read_splat(path)) == 1


def test_columns_may_come_in_any_order(
    path: Path, scene: GaussianScene, rng: np.random.Generator
) -> None:
    order = rng.permutation(len(splat_columns(1)))
    write_table(path, [splat_columns(1)[i] for i in order], splat_table(scene)[:, order])
    np.testing.assert_array_equal(read_splat(path).sh, scene.sh)


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


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    ("comment", "antialiased"),
    [
        ("SplatRenderMode: mip", True),
        ("antialiased 1", True),
        ("antialiased 0", False),
        ("SplatRenderMode: default", False),
        ("Vertical axis: y", False),
    ],
)
def test_antialiased_tags(
    comment: str, antialiased: bool, encoding: str, path: Path, scene: GaussianScene
) -> None:
    write_splat(path, scene, comments=["made by a test", comment], encoding=encoding)
    assert read_splat(path).antialiased is antialiased


def test_a_texture_comment_makes_no_noise(
    path: Path, scene: GaussianScene, caplog: pytest.LogCaptureFixture
) -> None:
    write_splat(path, scene, comments=["TextureFile foo.png"])
    with caplog.at_level(logging.WARNING):
        read_splat(path)
    assert caplog.records == []


def test_no_file(tmp_path: Path) -> None:
    assert_refused(tmp_path / "absent.ply", "does not exist")
    assert_refused(tmp_path, "not a file")


@pytest.mark.parametrize(
    "content", [b"", b"\n", b"ply", b"ply\n", b"Not a splat, but a text.\n", b"\x89PNG\r\n\x1a\n"]
)
def test_not_a_ply(content: bytes, path: Path) -> None:
    path.write_bytes(content)
    assert_refused(path, "not a readable PLY")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_point_cloud(encoding: str, path: Path) -> None:
    write_table(path, ("x", "y", "z"), np.zeros((5, 3), np.float32), encoding=encoding)
    assert_refused(path, "not a Gaussian splat")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_no_gaussians(encoding: str, path: Path) -> None:
    columns = splat_columns(0)
    write_table(path, columns, np.zeros((0, len(columns)), np.float32), encoding=encoding)
    assert_refused(path, "empty")


@pytest.mark.parametrize("column", ["opacity", "scale_1", "rot_0", "f_dc_1"])
def test_a_missing_column(column: str, path: Path, scene: GaussianScene) -> None:
    keep = [i for i, name in enumerate(splat_columns(1)) if name != column]
    write_table(path, [splat_columns(1)[i] for i in keep], splat_table(scene)[:, keep])
    assert_refused(path, column)


@pytest.mark.parametrize("count", [1, 8, 10, 23, 44, 46])
def test_a_wrong_number_of_rest_coefficients(count: int, path: Path) -> None:
    columns = [name for name in splat_columns(0)] + [f"f_rest_{i}" for i in range(count)]
    write_table(path, columns, np.zeros((3, len(columns)), np.float32))
    assert_refused(path, f"{count} f_rest", "0, 9, 24 or 45")


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


@pytest.mark.parametrize("name", ["a.splat", "a.spz", "a.sog", "a.txt", "a"])
def test_a_ply_under_another_ending(name: str, path: Path, scene: GaussianScene) -> None:
    write_splat(path.with_name(name), scene)
    np.testing.assert_array_equal(read_splat(path.with_name(name)).means, scene.means)


@pytest.mark.parametrize(
    ("name", "content", "remedy"),
    [
        ("a.lcc", b"{}", "give the splat's file"),
        ("a.lcc", b"\x01binary", "npx @playcanvas/splat-transform"),
        ("a.ckpt", b"\x80\x02", "ns-export"),
        ("a.glb", b"glTF\x02", "export a .ply"),
        ("a.xyz", b"1 2 3", "splat-transform"),
        ("a.gz", gzip.compress(b"ply\nformat ascii 1.0\n"), "gunzip"),
    ],
)
def test_other_files_are_told_what_converts_them(
    name: str, content: bytes, remedy: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    assert_refused(tmp_path / name, remedy)


@pytest.mark.parametrize(
    ("inner", "remedy"), [("archive/data.pkl", "ns-export"), ("scene.ply", "unpack it")]
)
def test_zip_archives(inner: str, remedy: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr(inner, "x")
    assert_refused(tmp_path / "a.zip", remedy)


@pytest.mark.parametrize("claimed", [19, 21, 10**9, 10**15, -1])
def test_the_header_claims_another_count(claimed: int, path: Path, scene: GaussianScene) -> None:
    write_splat(path, scene)
    data = path.read_bytes().replace(b"vertex 20\n", b"vertex %d\n" % claimed)
    path.write_bytes(data)
    assert_refused(path, "not a readable PLY")


def test_ascii_with_missing_lines_or_words(path: Path, scene: GaussianScene) -> None:
    write_splat(path, scene, encoding="ascii")
    text = path.read_text()
    for cut in (text[: text.rindex("\n", 0, -1) + 1], text[: text.rindex(" ")] + "\n"):
        path.write_text(cut)
        assert_refused(path)
    path.write_text(text.replace("-", "x"))
    assert_refused(path)


def assert_loads_or_is_refused(path: Path, what: str) -> bool:
    """Whether it loaded. Any exception but SplatError fails, with the damage's name."""
    try:
        scene = read_splat(path)
    except SplatError as error:
        assert str(path) in str(error), what
        return False
    except Exception as error:
        raise AssertionError(f"{what} raised {error!r}") from error
    assert_valid(scene)
    return True


@pytest.mark.parametrize("encoding", ["binary_little_endian", "ascii"])
def test_truncated_files(encoding: str, path: Path, scene: GaussianScene) -> None:
    write_splat(path, scene, encoding=encoding)
    data = path.read_bytes()
    rng = np.random.default_rng(1)
    for length in rng.integers(0, len(data), 40):
        path.write_bytes(data[:length])
        loaded = assert_loads_or_is_refused(path, f"the first {length} bytes")
        # Text may end within its last number, which nobody can see.
        assert not loaded or (encoding == "ascii" and length > len(data) - 14)


@pytest.mark.parametrize("encoding", ["binary_little_endian", "ascii"])
def test_files_with_one_wrong_byte(encoding: str, path: Path, scene: GaussianScene) -> None:
    write_splat(path, scene, encoding=encoding)
    data = path.read_bytes()
    header = len(splat_header(splat_columns(1), len(scene), encoding=encoding))
    rng = np.random.default_rng(2)
    in_header = rng.integers(0, header, 100)
    in_body = rng.integers(header, len(data), 100)
    for offset in (*in_header, *in_body):
        damaged = bytearray(data)
        damaged[offset] ^= rng.integers(1, 256)
        path.write_bytes(damaged)
        assert_loads_or_is_refused(path, f"byte {offset} = {damaged[offset]}")
