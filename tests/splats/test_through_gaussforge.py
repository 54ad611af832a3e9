# SPDX-License-Identifier: Apache-2.0
"""Splats in other formats than .ply: what they keep, and damaged ones."""

from __future__ import annotations

import gzip
import importlib.util
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from helpers import random_scene, write_splat
from numpy.typing import NDArray

from gscpe.cli.main import main
from gscpe.errors import MissingDependencyError, SplatError
from gscpe.splats import GaussianScene, read_splat, through_gaussforge
from gscpe.splats.gaussians import SH_C0
from gscpe.splats.splat_kind import may_have_other_axes

gaussforge = pytest.importorskip("gaussforge", reason="gaussforge is an optional package")

KINDS = ["splat", "ksplat", "spz", "sog", "compressed.ply"]
# How far centres (absolute), scales (relative), opacities and colours may be off.
TOLERANCES = {
    "splat": (1e-6, 1e-6, 0.004, 0.004),
    "ksplat": (1e-6, 1e-6, 0.004, 0.004),
    "spz": (5e-4, 0.04, 0.004, 0.006),
    "sog": (2e-3, 0.04, 0.004, 0.006),
    "compressed.ply": (5e-3, 0.01, 0.004, 0.006),
}


def encoded(scene: GaussianScene, kind: str, folder: Path) -> bytes:
    write_splat(folder / "original.ply", scene)
    ply = (folder / "original.ply").read_bytes()
    answer = gaussforge.GaussForge().convert(ply, "ply", kind)
    return bytes(answer["data"])


def base_colour(scene: GaussianScene) -> NDArray[np.float32]:
    """Without harmonics, in [0, 1]: more is more than some formats can hold."""
    return np.asarray(np.clip(0.5 + SH_C0 * scene.sh[:, 0], 0.0, 1.0), dtype=np.float32)


def write(folder: Path, kind: str, data: bytes) -> Path:
    path = folder / f"scene.{kind}"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_what_comes_back(
    kind: str,
    degree: int,
    tmp_path: Path,
    rng: np.random.Generator,
    capfd: pytest.CaptureFixture[str],
) -> None:
    scene = random_scene(rng, 300, degree)
    back = read_splat(write(tmp_path, kind, encoded(scene, kind, tmp_path)))
    capfd.readouterr()
    read_splat(tmp_path / f"scene.{kind}")
    assert capfd.readouterr().out == ""  # what C code prints would spoil --json
    assert len(back) == len(scene)
    assert back.sh_degree == (0 if kind == "splat" else degree)
    # Some formats put the Gaussians into another order: compare each with the nearest.
    distance = np.linalg.norm(scene.means[:, None] - back.means[None], axis=2)
    nearest = distance.argmin(axis=1)
    centre, scale, opacity, colour = TOLERANCES[kind]
    assert distance.min(axis=1).max() < centre
    np.testing.assert_allclose(
        np.sort(back.scales[nearest], axis=1), np.sort(scene.scales, axis=1), rtol=scale
    )
    np.testing.assert_allclose(back.opacities[nearest], scene.opacities, atol=opacity)
    np.testing.assert_allclose(base_colour(back)[nearest], base_colour(scene), atol=colour)


@pytest.mark.parametrize("version", [2, 3, 4])
def test_spz_without_gzip(version: int, tmp_path: Path, rng: np.random.Generator) -> None:
    """Version 4 has none; some programs leave it away from earlier ones."""
    scene = random_scene(rng, 50, 1)
    write_splat(tmp_path / "original.ply", scene)
    ply = (tmp_path / "original.ply").read_bytes()
    data = gaussforge.GaussForge().convert(ply, "ply", "spz", spz_version=version)["data"]
    if version < 4:
        data = gzip.decompress(data)
    assert data[:4] == b"NGSP"
    for name in ("a.spz", "a.bin"):
        (tmp_path / name).write_bytes(data)
        np.testing.assert_allclose(read_splat(tmp_path / name).means, scene.means, atol=5e-4)


def sog_folder(folder: Path, scene: GaussianScene) -> GaussianScene:
    """Writes it as SOG's meta.json and images; returns what the packed .sog reads as."""
    folder.mkdir(parents=True)
    packed = write(folder.parent, "sog", encoded(scene, "sog", folder.parent))
    with zipfile.ZipFile(packed) as archive:
        archive.extractall(folder)
    return read_splat(packed)


def test_sog_as_a_folder(tmp_path: Path, rng: np.random.Generator) -> None:
    expected = sog_folder(tmp_path / "scene", random_scene(rng, 300, 1))
    for path in (tmp_path / "scene" / "meta.json", tmp_path / "scene"):
        again = read_splat(path)
        np.testing.assert_array_equal(again.means, expected.means)
        np.testing.assert_array_equal(again.sh, expected.sh)
    (tmp_path / "scene" / "quats.webp").unlink()
    with pytest.raises(SplatError, match=r"names quats\.webp, which is not beside it"):
        read_splat(tmp_path / "scene")


def test_sog_in_levels_of_detail(tmp_path: Path, rng: np.random.Generator) -> None:
    """The finest level of each leaf, and the environment; coarser ones are left out."""
    fine = sog_folder(tmp_path / "0_0", random_scene(rng, 60, 1))
    coarse = sog_folder(tmp_path / "1_0", random_scene(rng, 20, 1))
    around = sog_folder(tmp_path / "env", random_scene(rng, 5, 0))
    meta = {
        "version": 1,
        "lodLevels": 2,
        "filenames": ["0_0/meta.json", "1_0/meta.json"],
        "environment": "env/meta.json",
        "tree": {
            "children": [
                {"lods": {"0": {"file": 0, "offset": 0, "count": 40},
                          "1": {"file": 1, "offset": 0, "count": 12}}},
                {"lods": {"0": {"file": 0, "offset": 40, "count": 20}}},
                {"lods": {"1": {"file": 1, "offset": 15, "count": 5}}},
            ]
        },
    }  # fmt: skip
    (tmp_path / "lod-meta.json").write_text(json.dumps(meta))
    again = read_splat(tmp_path)
    expected = [fine.means, coarse.means[15:], around.means]
    np.testing.assert_array_equal(again.means, np.concatenate(expected))
    assert again.sh.shape == (70, 4, 3)
    assert not again.sh[65:, 1:].any()
    meta["filenames"] = ["0_0/meta.json"]
    (tmp_path / "lod-meta.json").write_text(json.dumps(meta))
    with pytest.raises(SplatError, match="levels of detail"):
        read_splat(tmp_path)


@pytest.mark.parametrize("name", ["meta.json", "lod-meta.json"])
@pytest.mark.parametrize(
    "text",
    ["{", "{}", '{"means": 3}', '{"means": {"files": ["../a"]}}', '{"filenames": ["lod-meta.json"],'
     ' "tree": {"lods": {"0": {"file": 0, "offset": 0, "count": 1}}}}', '{"tree": [], '
     '"filenames": []}', '{"tree": {}, "filenames": []}'],
)  # fmt: skip
def test_damaged_indices_of_folders(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SplatError, match=name):
        read_splat(tmp_path / name)


@pytest.mark.parametrize("kind", KINDS)
def test_which_formats_leave_their_axes_open(
    kind: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    path = write(tmp_path, kind, encoded(random_scene(rng, 20, 1), kind, tmp_path))
    assert may_have_other_axes(path) == (kind in ("spz", "sog"))
    assert not may_have_other_axes(tmp_path / "original.ply")
    sog_folder(tmp_path / "folder", random_scene(rng, 20, 1))
    assert may_have_other_axes(tmp_path / "folder" / "meta.json")
    with pytest.raises(SplatError, match=r"absent\.spz cannot be read"):
        may_have_other_axes(tmp_path / "absent.spz")


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Cut off, or with up to three bytes changed, most of them near the beginning."""
    if rng.random() < 0.3:
        return data[: rng.integers(len(data))]
    changed = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        changed[rng.integers(min(len(data), rng.choice([20, 400, len(data)])))] = rng.integers(256)
    return bytes(changed)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files(kind: str, tmp_path: Path) -> None:
    """They load as valid splats or are refused by name; .spz also within its gzip, which has
    a checksum of its own. Set GSCPE_MUTATIONS to try more than the usual number."""
    rng = np.random.default_rng(0)
    data = encoded(random_scene(rng, 50, 1), kind, tmp_path)
    cases = [b"", b"hello"]
    for number in range(int(os.environ.get("GSCPE_MUTATIONS", "10"))):
        if kind == "spz" and number % 3:
            cases.append(gzip.compress(damaged(gzip.decompress(data), rng)))
        else:
            cases.append(damaged(data, rng))
    for case in cases:
        try:
            scene = read_splat(write(tmp_path, kind, case))
        except SplatError as error:
            assert f"scene.{kind}" in str(error)
        else:
            for name in ("means", "quaternions", "scales", "opacities", "sh"):
                assert np.all(np.isfinite(getattr(scene, name))), name


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits a process's memory")
def test_the_converter_cannot_take_all_memory() -> None:
    """A damaged .ksplat made gaussforge ask for 17 GB."""
    program = "from gaussforge_program import limit_memory; limit_memory(10); bytearray(3 * 2**30)"
    folder = Path(through_gaussforge.__file__).parent
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.stderr.endswith("MemoryError\n")


def test_without_gaussforge_the_remedy_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(MissingDependencyError, match=r"gscpe\[formats\]"):
        read_splat(write(tmp_path, "spz", b"anything"))


def test_axes_that_nothing_is_compared_with(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = random_scene(rng, 20, 0)
    for kind, said in (("spz", True), ("ply", False)):
        path = tmp_path / "original.ply"
        write_splat(path, scene)
        if kind != "ply":
            path = write(tmp_path, kind, encoded(scene, kind, tmp_path))
        output = str(tmp_path / f"{kind}.gsmap")
        assert main(["build-map", str(path), "--no-references", "--output", output]) == 0
        assert ("does not say its axes" in capsys.readouterr().err) == said
