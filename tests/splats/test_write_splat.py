# SPDX-License-Identifier: Apache-2.0
"""Writing splats: what comes back, what the formats cannot hold, and outputs that fail."""

from __future__ import annotations

import errno
import gzip
import importlib.util
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import random_scene
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

import gscpe
from gscpe.errors import MissingDependencyError, OutputError
from gscpe.splats import GaussianScene, read_splat, write_splat
from gscpe.splats.ply_bytes import ply_bytes
from gscpe.splats.spz import best_exponent, encode_spz, max_exponent

needs_gaussforge = pytest.mark.skipif(
    importlib.util.find_spec("gaussforge") is None, reason="gaussforge is an optional package"
)


def assert_equal_but_for_rounding(back: GaussianScene, scene: GaussianScene) -> None:
    """To what the logarithm and the logit of float32 keep."""
    # Far from zero, the means are relative to an origin.
    np.testing.assert_allclose(
        back.means.astype(np.float64) + back.origin,
        scene.means,
        rtol=1.2e-7,
        atol=1.2e-7 * np.abs(back.origin).max(),
    )
    np.testing.assert_array_equal(back.sh, scene.sh)
    np.testing.assert_allclose(back.quaternions, scene.quaternions, atol=1e-6)
    # A logarithm of up to 87 is rounded by up to 2**-18, so its exponential by a share of it.
    np.testing.assert_allclose(back.scales, scene.scales, rtol=1.2e-5, atol=1.2e-38)
    np.testing.assert_allclose(back.opacities, scene.opacities, rtol=1e-5, atol=1e-37)
    certain = (scene.opacities == 0) | (scene.opacities == 1)
    np.testing.assert_array_equal(back.opacities[certain], scene.opacities[certain])
    assert back.antialiased is scene.antialiased


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_ply_is_exact(
    degree: int, antialiased: bool, tmp_path: Path, rng: np.random.Generator
) -> None:
    scene = random_scene(rng, 50, degree, antialiased=antialiased)
    gscpe.write_splat(scene, tmp_path / "new folder" / "a splat.ply")
    back = read_splat(str(tmp_path / "new folder" / "a splat.ply"))
    assert_equal_but_for_rounding(back, scene)
    np.testing.assert_allclose(back.scales, scene.scales, rtol=1e-6)
    assert os.listdir(tmp_path / "new folder") == ["a splat.ply"]


floats = st.floats(-(2.0**49), 2.0**49, width=32)


@given(
    means=arrays(np.float32, (3, 3), elements=floats),
    scales=arrays(np.float32, (3, 3), elements=st.floats(2.0**-125, 2.0**49, width=32)),
    opacities=arrays(np.float32, 3, elements=st.floats(0.0, 1.0, width=32)),
    sh=arrays(np.float32, (3, 4, 3), elements=floats),
)
def test_ply_of_any_values(
    means: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    sh: np.ndarray,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    quaternions = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0.5, 0.5, -0.5, 0.5]], np.float32)
    scene = GaussianScene(means, quaternions, scales, opacities, sh)
    path = tmp_path_factory.getbasetemp() / "any.ply"
    write_splat(scene, path)
    assert_equal_but_for_rounding(read_splat(path), scene)


def angles_between(a: GaussianScene, b: GaussianScene) -> np.ndarray:
    """Degrees between the rotations of two splats, (N,)."""
    turned = [Rotation.from_quat(np.roll(s.quaternions, -1, axis=1)) for s in (a, b)]
    return np.asarray(np.degrees((turned[0].inv() * turned[1]).magnitude()))


def assert_within_spz_precision(
    back: GaussianScene, scene: GaussianScene, coordinate_step: float
) -> None:
    """Half a step each, as encode_spz documents."""
    assert np.abs(back.means.astype(np.float64) - scene.means).max() <= 0.501 * coordinate_step
    assert np.abs(np.log(back.scales / scene.scales)).max() < 1 / 32 + 1e-5
    assert np.abs(back.opacities - scene.opacities).max() < 0.501 / 255
    assert angles_between(back, scene).max() < 0.25
    assert np.abs(back.sh[:, 0] - scene.sh[:, 0]).max() < 0.501 / (255 * 0.15)
    assert np.abs(back.sh[:, 1:] - scene.sh[:, 1:]).max(initial=0.0) <= 1 / 128 + 1e-6
    assert back.antialiased is scene.antialiased


def scene_for_spz(rng: np.random.Generator, degree: int, size: float) -> GaussianScene:
    """A scene with coordinates up to ``size``; scales of about a hundredth of it."""
    scene = random_scene(rng, 100, degree, opacity=(0.0, 1.0), antialiased=degree % 2 == 1)
    largest = np.abs(scene.means).max()
    return replace(
        scene,
        means=np.asarray(scene.means * (size / largest), dtype=np.float32),
        scales=np.asarray(np.clip(scene.scales * size / 10, 5e-5, 370.0), dtype=np.float32),
        sh=np.clip(scene.sh, -0.95, 0.95) if degree else scene.sh,
        opacities=np.where(np.arange(100) < 2, np.arange(100), scene.opacities).astype(np.float32),
    )


@needs_gaussforge
@pytest.mark.parametrize(
    ("degree", "size"), [(0, 5.0), (1, 2e-2), (2, 2047.9), (3, 8e6), (1, 2.0), (0, 4.0)]
)
def test_spz_within_its_precision(
    degree: int, size: float, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Whatever the size of the scene, coordinates keep 22 bits."""
    scene = scene_for_spz(rng, degree, size)
    write_splat(scene, tmp_path / "scene.SPZ")
    back = read_splat(tmp_path / "scene.SPZ")
    assert_within_spz_precision(back, scene, size * 2.0**-22)
    assert back.opacities[:2].tolist() == [0.0, 1.0]


@needs_gaussforge
def test_an_exponent_multiplies_all_lengths(tmp_path: Path, rng: np.random.Generator) -> None:
    scene = scene_for_spz(rng, 1, 4.0)
    exponent = best_exponent(scene)
    assert 190 < scene.scales.max() * 2.0**exponent < 380
    (tmp_path / "a.spz").write_bytes(encode_spz(scene, exponent))
    larger = replace(scene, means=scene.means * 2.0**exponent, scales=scene.scales * 2.0**exponent)
    assert_within_spz_precision(read_splat(tmp_path / "a.spz"), larger, 2.0 ** (exponent - 20))


@given(largest=st.floats(2.0**-100, 2.0**49, width=32))
def test_coordinates_use_the_whole_range(largest: float) -> None:
    one = np.ones((1, 1), np.float32)
    scene = GaussianScene(
        np.array([[0, -largest, 0]], np.float32),
        np.array([[1, 0, 0, 0]], np.float32),
        np.ones((1, 3), np.float32),
        one[0],
        np.zeros((1, 1, 3), np.float32),
    )
    stored = largest * 2.0 ** max_exponent(scene)
    assert 2**22 - 1 <= stored <= 2**23 - 1


@needs_gaussforge
def test_the_header_of_an_spz(rng: np.random.Generator) -> None:
    """As other programs parse it: magic, version, count, degree, fractional bits, flags."""
    header = gzip.decompress(encode_spz(random_scene(rng, 9, 2, antialiased=True)))[:16]
    assert header[:4] == b"NGSP"
    assert np.frombuffer(header[4:12], "<u4").tolist() == [3, 9]
    assert [header[12], header[14], header[15]] == [2, 1, 0]
    plain = gzip.decompress(encode_spz(random_scene(rng, 9, 0)))[:16]
    assert [plain[12], plain[14], plain[15]] == [0, 0, 0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda s: replace(s, means=s.means * np.float32(1e7)),
            "holds up to .*write a .ply, or scale",
        ),
        (
            lambda s: replace(s, means=s.means * np.float32(1e14)),
            "holds up to .*write a .ply, or scale",
        ),
        (
            lambda s: replace(s, scales=s.scales * np.float32(1e4)),
            "holds up to .*write a .ply, or scale",
        ),
        (
            lambda s: replace(s, scales=s.scales * np.float32(1e14)),
            "holds up to .*write a .ply, or scale",
        ),
        (
            lambda s: replace(s, scales=s.scales * np.float32(1e-5)),
            "the smallest size that .spz holds; write a .ply",
        ),
    ],
)
def test_scenes_beyond_the_range_of_spz(
    change: object, words: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    assert callable(change)
    scene = change(random_scene(rng, 50, 0))
    with pytest.raises(OutputError, match=words) as caught:
        write_splat(scene, tmp_path / "a.spz")
    assert str(tmp_path / "a.spz") in str(caught.value)
    assert list(tmp_path.iterdir()) == []
    write_splat(scene, tmp_path / "a.ply")


@needs_gaussforge
def test_thin_axes_and_a_few_specks_are_clipped(tmp_path: Path, rng: np.random.Generator) -> None:
    scene = random_scene(rng, 200, 0)
    scales = scene.scales.copy()
    scales[:, 2] = 1e-9
    scales[7] = 1e-7
    write_splat(replace(scene, scales=scales), tmp_path / "a.spz")
    back = read_splat(tmp_path / "a.spz").scales
    np.testing.assert_allclose(back[:, 2], np.exp(-10.0), rtol=1e-5)
    np.testing.assert_allclose(np.delete(back, 7, 0)[:, :2], np.delete(scales, 7, 0)[:, :2], 0.032)


@needs_gaussforge
@pytest.mark.parametrize("values", [{"means": 1e6}, {"scales": 1e4}])
def test_a_far_or_huge_gaussian_is_left_out_of_an_spz(
    values: dict[str, float],
    tmp_path: Path,
    rng: np.random.Generator,
    caplog: pytest.LogCaptureFixture,
) -> None:
    scene = random_scene(rng, 200, 0, scale=(0.005, 0.01))
    for name, value in values.items():
        getattr(scene, name)[5] = value
    write_splat(scene, tmp_path / "a.spz")
    assert "1 of 200 Gaussians are left out of the .spz" in caplog.text
    back = read_splat(tmp_path / "a.spz")
    np.testing.assert_allclose(back.means, np.delete(scene.means, 5, axis=0), atol=1e-5)


@pytest.mark.parametrize("name", ["a.splat", "a", "a.ply.gz", "a.sog"])
def test_other_endings(name: str, tmp_path: Path, rng: np.random.Generator) -> None:
    with pytest.raises(OutputError, match=r"use \.ply or \.spz") as caught:
        write_splat(random_scene(rng, 3, 0), tmp_path / name)
    assert name in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_without_gaussforge_the_remedy_is_named(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'gscpe\[formats\]'"):
        write_splat(random_scene(rng, 3, 0), tmp_path / "a.spz")
    write_splat(random_scene(rng, 3, 0), tmp_path / "a.ply")


def test_a_full_disk_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.ply"
    scene = random_scene(rng, 3, 0)
    write_splat(scene, path)

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fail)
        with pytest.raises(OutputError, match=r"a\.ply cannot be written: No space left"):
            write_splat(random_scene(rng, 5, 0), path)
    assert path.read_bytes() == ply_bytes(scene)
    assert list(tmp_path.iterdir()) == [path]
    write_splat(random_scene(rng, 5, 0), path)
    assert len(read_splat(path)) == 5


def test_what_a_link_leads_to_is_replaced(tmp_path: Path, rng: np.random.Generator) -> None:
    target, link = tmp_path / "a.ply", tmp_path / "current.ply"
    target.write_bytes(b"old")
    link.symlink_to(target.name)
    scene = random_scene(rng, 5, sh_degree=0)
    write_splat(scene, link)
    assert link.is_symlink()
    assert len(read_splat(target)) == 5
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.ply", "current.ply"]


def test_a_folder_is_in_the_way(tmp_path: Path, rng: np.random.Generator) -> None:
    (tmp_path / "a.ply").mkdir()
    (tmp_path / "file").write_text("hello")
    for path in (tmp_path / "a.ply", tmp_path / "file" / "a.ply"):
        with pytest.raises(OutputError, match="cannot be written"):
            write_splat(random_scene(rng, 3, 0), path)
    assert sorted(os.listdir(tmp_path)) == ["a.ply", "file"]
