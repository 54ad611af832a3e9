# SPDX-License-Identifier: Apache-2.0
"""Reading 3DGS ``.ply`` files: what is stored comes back, and damage is named."""

from __future__ import annotations

import gzip
import logging
import zipfile
from pathlib import Path

import numpy as np
import pytest
from helpers import random_scene, splat_columns, splat_header, splat_table, write_splat, write_table
from splat_checks import ENCODINGS, assert_refused, assert_valid

from gscpe.errors import SplatError
from gscpe.splats import GaussianScene, read_splat


@pytest.fixture
def scene(rng: np.random.Generator) -> GaussianScene:
    return random_scene(rng, 20, 1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "kitchen splat.ply"


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
