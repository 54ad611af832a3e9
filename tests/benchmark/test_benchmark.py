# SPDX-License-Identifier: Apache-2.0
"""A tiny 7-Scenes from its folder to tables and report, by the command line.

The scene is the ray-cast room: its photos are real pictures of it, its splat a map of one
RGB-D photo.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from dataset_folders import wxyz
from scenes import room, write_colmap_model

from gscpe.benchmark import BenchmarkSettings, ScenePaths, benchmark_scene
from gscpe.benchmark.dataset_map import _recipe
from gscpe.benchmark.scene import chosen_queries
from gscpe.cli.main import main
from gscpe.datasets import Dataset, read_seven_scenes
from gscpe.errors import SettingsError, SplatError
from gscpe.evaluation import evaluate
from gscpe.geometry import Camera, se3
from gscpe.mapping import scene_from_rgbd
from gscpe.photos import write_image
from gscpe.poses.hloc import format_pose, read_poses
from gscpe.splats import write_splat

FOCAL = 205.0
CAMERA = Camera.pinhole(240, 180, fx=FOCAL, fy=FOCAL, cx=120, cy=90)
BASE = se3.exp([0.05, -0.1, 0.1, 0.05, -0.12, 0.03])
SHIFTS = np.linspace(-0.06, 0.06, 4)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences of four frames, seq-01 to train and seq-03 to test; splats/redkitchen.ply."""
    root = tmp_path_factory.mktemp("7scenes")
    folder = root / "redkitchen"
    for split, sequence, aside in (("Train", 1, 0.0), ("Test", 3, 0.03)):
        lines = []
        for frame, shift in enumerate(SHIFTS):
            pose = se3.exp([shift, aside, 0.5 * aside, aside / 3, 0.2 * shift, 0]) @ BASE
            stem = f"seq-{sequence:02d}/frame-{frame:06d}"
            (folder / f"seq-{sequence:02d}").mkdir(parents=True, exist_ok=True)
            write_image(folder / f"{stem}.color.png", room().shoot(CAMERA, pose, 2).uint8)
            np.savetxt(folder / f"{stem}.pose.txt", np.linalg.inv(pose))
            numbers = " ".join(f"{x:.9f}" for x in (*wxyz(pose), *pose[:3, 3], FOCAL))
            lines.append(f"{stem}.color.png {numbers}")
        (folder / f"{split}Split.txt").write_text(f"sequence{sequence}\n")
        (folder / f"redkitchen_{split.lower()}.txt").write_text("\n".join(lines) + "\n")
    shot = room().shoot(CAMERA, BASE)
    (root / "splats").mkdir()
    splat = scene_from_rgbd(shot.uint8, shot.depth, CAMERA, BASE)
    write_splat(splat, root / "splats" / "redkitchen.ply")
    return root


def command(root: Path, output: Path, *more: str, splat: str = "{scene}") -> list[str]:
    return [
        *("benchmark", "7scenes", str(root), "--scene", "redkitchen", "--matcher", "sift"),
        *("--splat", str(root / "splats" / f"{splat}.ply"), "--output", str(output), *more),
    ]


@pytest.fixture(scope="module")
def results(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("results")
    assert main(command(root, output, "--ablation", "--workers", "1")) == 0
    return output


def test_all_files_are_there(results: Path) -> None:
    names = {path.name for path in (results / "redkitchen").iterdir()}
    assert names >= {
        *("map.gsmap", "details.jsonl", "poses-final.txt", "poses-coarse.txt", "report.html"),
        *("truth-sfm.txt", "truth-original.txt"),
    }
    for ending in ("txt", "md", "tex", "json"):
        assert (results / f"tables.{ending}").stat().st_size > 200


def test_the_tables_say_what_the_files_say(results: Path) -> None:
    scene = results / "redkitchen"
    poses, truth = read_poses(scene / "poses-final.txt"), read_poses(scene / "truth-sfm.txt")
    assert len(truth) == 4
    found = evaluate(poses, truth)
    assert found.localized == 4
    assert found.median_distance < 4e-3
    centimetres = f"{100 * found.median_distance:.3f} / {found.median_degrees:.3f}"
    text = (results / "tables.txt").read_text()
    assert centimetres in text
    assert "ground truth sfm" in text
    assert "ground truth original" in text
    table = json.loads((results / "tables.json").read_text())["tables"][0]
    final = next(row for row in table["rows"] if row["stage"] == "final")
    said = final["scenes"]["redkitchen"]
    assert said["median_position_cm"] == pytest.approx(100 * found.median_distance, rel=1e-9)


def test_published_rows_only_beside_the_same_split(root: Path, results: Path) -> None:
    assert "0.72 / 0.27" in (results / "tables.md").read_text()
    output = results / "fewer"
    more = ("--limit", "2", "--no-report", "--workers", "1")
    assert main(command(root, output, *more)) == 0
    text = (output / "tables.md").read_text()
    assert "0.72 / 0.27" not in text
    assert "2 of 4 queries" in text
    assert not (output / "redkitchen" / "report.html").exists()
    assert len(read_poses(output / "redkitchen" / "truth-sfm.txt")) == 2


def test_the_ablation_is_in_the_tables(results: Path) -> None:
    text = (results / "tables.txt").read_text()
    for row in ("full", "without multi-scale", "without mask", "without mask (published)"):
        assert row in text


def test_resuming_keeps_what_still_holds(root: Path, results: Path, tmp_path: Path) -> None:
    output = tmp_path / "copy"
    shutil.copytree(results, output)
    paths = ScenePaths(output / "redkitchen")
    map_before = (paths.map / "map.json").stat().st_mtime_ns
    record = paths.details().read_text()
    splat = tmp_path / "splat.ply"
    shutil.copy(root / "splats" / "redkitchen.ply", splat)
    dataset = read_seven_scenes(root, "redkitchen")
    settings = BenchmarkSettings(matcher="sift", workers=1, resume=True, report=None)
    run = benchmark_scene(dataset, splat, paths.folder, settings)
    assert (paths.map / "map.json").stat().st_mtime_ns == map_before
    assert paths.details().read_text() == record
    assert len(run.poses("final")) == 4

    # A reference photo changed under its name: no map is kept that was made of the old one.
    first = dataset.image_folder / dataset.references.names[0]
    recipe, photo = _recipe(dataset, splat, settings), first.read_bytes()
    try:
        first.write_bytes(photo[:-1] + b"?")
        assert _recipe(dataset, splat, settings) != recipe
    finally:
        first.write_bytes(photo)
    assert _recipe(dataset, splat, settings) == recipe

    # Another splat: the map is made anew, and so are the poses.
    shot = room().shoot(CAMERA, BASE)
    write_splat(scene_from_rgbd(shot.uint8 // 2, shot.depth, CAMERA, BASE), splat)
    benchmark_scene(dataset, splat, paths.folder, settings)
    assert (paths.map / "map.json").stat().st_mtime_ns > map_before
    assert paths.details().read_text() != record


def test_colmap_with_a_query_list(root: Path, tmp_path: Path) -> None:
    dataset = read_seven_scenes(root, "redkitchen")
    names = [Path(name).name for name in dataset.references.names]
    poses = dict(zip(names, dataset.references.cam_from_world, strict=True))
    write_colmap_model(tmp_path / "model", CAMERA, poses)
    queries = [Path(query.name).name for query in dataset.queries]
    (tmp_path / "queries.txt").write_text(
        "".join(f"{name} {CAMERA.colmap_text()}\n" for name in queries)
    )
    truth = [dataset.truths["sfm"][query.name] for query in dataset.queries]
    lines = (f"{name} {format_pose(pose)}\n" for name, pose in zip(queries, truth, strict=True))
    (tmp_path / "truth.txt").write_text("".join(lines))
    folder = root / "redkitchen"
    arguments = [
        *("benchmark", "colmap", str(tmp_path / "model"), "--images", str(folder / "seq-01")),
        *("--queries", str(tmp_path / "queries.txt"), "--query-images", str(folder / "seq-03")),
        *("--truth", str(tmp_path / "truth.txt"), "--metres-per-unit", "1", "--workers", "1"),
        *("--splat", str(root / "splats" / "redkitchen.ply"), "--output", str(tmp_path / "out")),
        *("--no-report", "--matcher", "sift", "--limit", "2"),
    ]
    assert main(arguments) == 0
    assert "100.0%" in (tmp_path / "out" / "tables.txt").read_text()


def test_nothing_is_begun_with_wrong_input(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out"
    assert main(command(root, output, splat="missing")) == 2
    assert "missing.ply" in capsys.readouterr().err
    two = command(root, output, splat="redkitchen")
    two.insert(two.index("redkitchen") + 1, "heads")
    assert main(two) == 2
    assert "heads" in capsys.readouterr().err
    shutil.copytree(root / "redkitchen", root / "chess")
    for split in ("train", "test"):
        (root / "chess" / f"redkitchen_{split}.txt").rename(root / "chess" / f"chess_{split}.txt")
    two[two.index("heads")] = "chess"
    assert main(two) == 2
    assert "{scene}" in capsys.readouterr().err
    assert not output.exists()


def test_wrong_settings(root: Path, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="limit must be"):
        BenchmarkSettings(limit=0)
    with pytest.raises(SettingsError, match="not both"):
        BenchmarkSettings(workers=2, scheduler="tcp://localhost:1")
    dataset = read_seven_scenes(root, "redkitchen")
    with pytest.raises(SplatError, match="nowhere"):
        benchmark_scene(dataset, tmp_path / "nowhere.ply", tmp_path / "out")


def test_fewer_queries_are_evenly_spread(root: Path) -> None:
    dataset: Dataset = read_seven_scenes(root, "redkitchen")
    assert chosen_queries(dataset, None) == chosen_queries(dataset, 9) == dataset.queries
    assert chosen_queries(dataset, 2) == (dataset.queries[0], dataset.queries[-1])


def test_all_scenes_are_those_that_are_there(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    everything = command(root, tmp_path / "out", "--limit", "1", "--no-report", "--workers", "1")
    everything[everything.index("redkitchen")] = "all"
    only = tmp_path / "only"
    only.mkdir()
    (only / "redkitchen").symlink_to(root / "redkitchen")
    everything[everything.index(str(root))] = str(only)
    assert main(everything) == 0
    out, err = capsys.readouterr()
    assert "redkitchen" in out
    assert "no folder chess, fire" in err
    everything[everything.index(str(only))] = str(tmp_path)
    assert main(everything) == 2
    assert "chess is missing" in capsys.readouterr().err
