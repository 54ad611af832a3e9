# SPDX-License-Identifier: Apache-2.0
"""``gscpe benchmark``: a data set from end to end."""

from __future__ import annotations

import argparse
import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Sequence

from gscpe.benchmark import BenchmarkSettings, ScenePaths, benchmark_scene, run_ablation
from gscpe.cli.benchmark_kinds import add_kinds
from gscpe.cli.common import (
    Commands,
    add_backend,
    add_matcher,
    add_timeout,
    add_workers,
    show_progress,
)
from gscpe.datasets import Dataset
from gscpe.errors import SettingsError
from gscpe.evaluation import SceneRun
from gscpe.evaluation.ablation_table import ablation_table
from gscpe.evaluation.table import Table, to_text
from gscpe.evaluation.tables import benchmark_tables, write_tables
from gscpe.report import ReportSettings
from gscpe.retrieval import METHODS

_log = logging.getLogger(__name__)


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser(
        "benchmark", help="localize a data set's test photos; write tables and a report"
    )
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument(
        "--splat",
        required=True,
        metavar="SPLAT",
        help="splat trained on the reference photos only, in the frame of their poses; {scene} "
        "in the path stands for the scene's name",
    )
    common.add_argument(
        "--output", required=True, metavar="DIR", help="folder for maps, poses, tables, reports"
    )
    common.add_argument(
        "--limit", type=int, metavar="N", help="localize N of the queries, evenly spread"
    )
    common.add_argument(
        "--resume", action="store_true", help="keep maps and poses that are still valid"
    )
    common.add_argument(
        "--ablation",
        action="store_true",
        help="localize again without multi-scale and without the mask, as the paper does",
    )
    common.add_argument("--no-report", action="store_true", help="write no HTML page")
    common.add_argument(
        "--no-check",
        action="store_true",
        help="do not check, by comparing renders with photos, that the splat fits the poses",
    )
    common.add_argument(
        "--retrieval",
        metavar="METHOD",
        default=BenchmarkSettings.retrieval,
        help=f"how photos are described: {', '.join(METHODS)} (default: %(default)s)",
    )
    add_workers(common)
    add_timeout(common)
    add_matcher(common)
    add_backend(common)
    common.add_argument("-v", "--verbose", action="store_true", help="log progress")
    add_kinds(parser, common)
    parser.set_defaults(run=run)


@dataclass(frozen=True)
class _Scene:
    dataset: Dataset
    splat: Path
    output: Path


def run(options: argparse.Namespace) -> int:
    settings = BenchmarkSettings(
        matcher=options.matcher,
        backend=options.backend,
        retrieval=options.retrieval,
        check_frames=not options.no_check,
        workers=options.workers,
        scheduler=options.scheduler,
        timeout=options.timeout or BenchmarkSettings.timeout,
        resume=options.resume,
        limit=options.limit,
        report=None if options.no_report else ReportSettings(date=time.strftime("%Y-%m-%d %H:%M")),
    )
    output = Path(options.output)
    # All are read before any long work, so that a missing file is not found out after hours.
    scenes = _scenes(options.read(options), options.splat, output)
    runs: list[SceneRun] = []
    ablations: list[Table] = []
    for scene in scenes:
        dataset = scene.dataset
        _log.info("%s %s", dataset.name, dataset.scene)
        done = benchmark_scene(
            dataset, scene.splat, scene.output, settings, progress=show_progress()
        )
        runs.append(done)
        if options.ablation:
            paths = ScenePaths(scene.output)
            rows = run_ablation(dataset, done, paths, settings, show_progress())
            title = f"Image alignment with parts left out: {dataset.name} {dataset.scene}"
            with_published = dataset.name == "7-Scenes"
            metric = dataset.metres_per_unit is not None
            table = ablation_table(title, rows, with_published=with_published, metric=metric)
            ablations.append(table)
        write_tables(runs, output, ablations)  # after each scene: finished work is never lost
    print(to_text((*benchmark_tables(runs), *ablations)))
    _say_where(scenes, output, settings)
    return 0 if any(run.poses("final") for run in runs) else 1


def _scenes(datasets: Sequence[Dataset], splat: str, output: Path) -> list[_Scene]:
    several = len(datasets) > 1
    if several and "{scene}" not in splat:
        raise SettingsError(
            f"{len(datasets)} scenes need a splat each: put {{scene}} into --splat, for example "
            "splats/{scene}.ply"
        )
    scenes = []
    for dataset in datasets:
        path = Path(splat.replace("{scene}", dataset.scene))
        if not path.is_file():
            raise SettingsError(f"splat {path} of {dataset.scene} is not a file")
        scenes.append(_Scene(dataset, path, output / dataset.scene))
    return scenes


def _say_where(scenes: Sequence[_Scene], output: Path, settings: BenchmarkSettings) -> None:
    print(f"tables: {output / 'tables.md'} (and .txt, .tex, .json)")
    for scene in scenes:
        paths = ScenePaths(scene.output)
        print(f"{scene.dataset.scene}: {paths.report if settings.report else scene.output}")
