# SPDX-License-Identifier: Apache-2.0
"""tools/ablate_training.py: a whole run on a small room, and what stays of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, write_colmap_model

from gscpe.geometry import se3
from gscpe.photos import write_image

pytest.importorskip("numba")
pytest.importorskip("pycolmap")

from gscpe.training import TrainingSettings


@pytest.fixture
def ablate(tool: Callable[[str], Any]) -> Any:
    return tool("ablate_training")


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator) -> Path:
    """Photos of a room, and two models: the second one's poses are a little off."""
    camera, poses, others = room_camera(240, 180), {}, {}
    for i in range(9):
        name = f"{i}.png"
        poses[name] = se3.exp(rng.normal(0.0, (0.1,) * 3 + (0.03,) * 3)) @ ROOM_POSE
        others[name] = se3.exp([0.05, 0, 0, 0, 0, 0]) @ poses[name]
        write_image(tmp_path / "photos" / name, room().shoot(camera, poses[name]).uint8)
    write_colmap_model(tmp_path / "model", camera, poses)
    write_colmap_model(tmp_path / "refined", camera, others)
    return tmp_path


def run(ablate: Any, folder: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> Any:
    """The tables of a run, from DIR."""
    where = ("--colmap", folder / "model", "--images", folder / "photos", "--work", folder / "work")
    small = ("--iterations", "60", "--max-size", "120", "--gaussians", "1500")
    monkeypatch.setattr("sys.argv", ["ablate", *map(str, where), *small, *options])
    code = ablate.main()
    return code, json.loads((folder / "work" / "tables.json").read_text()) if not code else None


def test_a_run_and_the_next(
    ablate: Any,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Photos left out are localized; what is finished is not trained again; both truths are told
    apart."""
    code, tables = run(ablate, folder, monkeypatch, "--only", "default")
    assert code == 0
    (row,) = tables["tables"][0]["rows"]
    assert row["photos"] == 2 and row["gaussians"] <= 1500
    assert row["localized"] == 1.0 and row["median_distance"] < 0.03 * row["scene_size"]
    assert 10 < row["psnr"] <= row["fitted_psnr"]
    assert "7 photos of 120 pixels learned from in 60 iterations, 2 localized" in (
        capsys.readouterr().out
    )
    for ending in ("txt", "md", "tex", "html"):
        assert "default" in (folder / "work" / f"tables.{ending}").read_text(encoding="utf-8")

    trained: list[Any] = []
    train = ablate.train

    def told(*arguments: Any, **others: Any) -> Any:
        trained.append(arguments)
        return train(*arguments, **others)

    monkeypatch.setattr(ablate, "train", told)
    refined = ("--refined-model", str(folder / "refined"))
    assert run(ablate, folder, monkeypatch, "--only", "default")[1] == tables
    assert not trained
    code, tables = run(ablate, folder, monkeypatch, *refined, "--only", "refined poses")
    assert code == 0 and len(trained) == 1
    given, other = tables["tables"][0]["rows"]
    assert (given["truth"], other["truth"]) == ("given", "refined")
    # What was trained with poses 5 cm off localizes photos 5 cm off.
    assert given["median_distance"] == pytest.approx(0.05, rel=0.5)
    assert other["median_distance"] < 0.02


def test_variants_differ_from_the_default_in_one_thing(ablate: Any) -> None:
    first, *others = ablate.variants(TrainingSettings(), refined=True)
    assert first.name == "default"
    for variant in others:
        changed = [
            key
            for key, value in vars(variant).items()
            if key != "name" and value != getattr(first, key)
        ]
        assert len(changed) == 1, variant.name
    assert len({variant.name for variant in (first, *others)}) == len(others) + 1


def test_blocks_are_spread_over_the_walk(tool: Callable[[str], Any]) -> None:
    scene = tool("ablation_scene")
    for count in (25, 26, 175):
        chosen = np.array(scene.in_blocks(count))
        assert len(chosen) == 25 and chosen[0] >= 0 and chosen[-1] < count
        assert np.all(np.diff(chosen.reshape(5, 5), axis=1) == 1)
    assert np.all(np.diff(chosen.reshape(5, 5)[:, 0]) == 35)


def test_bad_input(
    ablate: Any,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        run(ablate, folder, monkeypatch, "--only", "nothing")
    assert "no variant 'nothing'" in capsys.readouterr().err
    images = folder / "refined" / "images.txt"
    images.write_text("\n".join(images.read_text().splitlines()[:-4]) + "\n")
    refined = ("--refined-model", str(folder / "refined"), "--only", "default")
    assert run(ablate, folder, monkeypatch, *refined)[0] == 2
    assert "has no pose of" in capsys.readouterr().err
