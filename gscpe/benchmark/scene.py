# SPDX-License-Identifier: Apache-2.0
"""One scene: builds the map, localizes the queries, writes poses and the report."""

from __future__ import annotations

import platform
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Sequence

from gscpe.batch import (
    Detail,
    Instructions,
    ListFiles,
    check_outputs,
    localize_to_files,
)
from gscpe.benchmark.dataset_map import ensure_map
from gscpe.benchmark.settings import BenchmarkSettings
from gscpe.cores import available_cores
from gscpe.datasets import Dataset
from gscpe.evaluation import SceneRun
from gscpe.geometry.spread import thinned
from gscpe.localization import Localizer, LocalizerSettings
from gscpe.matching import make_matcher, matcher_name
from gscpe.poses import write_pose_file
from gscpe.report import write_report
from gscpe.scene import open_map
from gscpe.scene.query_list import Query


@dataclass(frozen=True)
class ScenePaths:
    """Where the results of a scene are, in a folder of its own."""

    folder: Path

    @property
    def map(self) -> Path:
        return self.folder / "map.gsmap"

    @property
    def report(self) -> Path:
        return self.folder / "report.html"

    def details(self, variant: str = "") -> Path:
        """The record, of the benchmark itself or of a variant with other settings."""
        return self.folder / f"details{'-' if variant else ''}{variant.replace(' ', '-')}.jsonl"

    def poses(self, stage: str) -> Path:
        return self.folder / f"poses-{stage}.txt"

    def truth(self, name: str) -> Path:
        return self.folder / f"truth-{name}.txt"


def benchmark_scene(
    dataset: Dataset,
    splat: str | Path,
    output: str | Path,
    settings: BenchmarkSettings | None = None,
    *,
    progress: bool = False,
) -> SceneRun:
    """Localizes the queries of a data set in a splat of its references.

    Writes to ``output``: ``map.gsmap``, ``details.jsonl``, ``poses-final.txt`` and
    ``poses-coarse.txt``, ``truth-NAME.txt`` and ``report.html``.

    Args:
        dataset: one scene, split into references and queries.
        splat: trained on the references alone, in the frame of their poses.
        output: folder for this scene's files.
        settings: see :class:`BenchmarkSettings`.
        progress: show bars.

    Raises:
        GscpeError: what building the map, localizing and writing raise.
    """
    settings = settings or BenchmarkSettings()
    paths = ScenePaths(Path(output))
    queries = chosen_queries(dataset, settings.limit)
    files = [paths.poses("final"), paths.poses("coarse"), paths.details()]
    check_outputs([*files, *([paths.report] if settings.report else [])], inputs=[splat])
    ensure_map(dataset, splat, paths.map, settings, progress)
    details, worked = localize_queries(dataset, queries, paths, settings, progress)
    run = SceneRun(
        dataset=dataset.name,
        scene=dataset.scene,
        details=tuple(details),
        truths=dataset.truths,
        metres_per_unit=dataset.metres_per_unit,
        setup=_setup(dataset, queries, settings, worked),
    )
    _write_truths(run, queries, paths)
    if settings.report is not None:
        matcher = make_matcher(settings.matcher)
        with Localizer(
            open_map(paths.map), settings.localizer, matcher, settings.backend
        ) as localizer:
            write_report(
                paths.report,
                run,
                localizer,
                dataset.query_folder or dataset.image_folder,
                settings.report,
                matcher,
                progress,
            )
    return run


def chosen_queries(dataset: Dataset, limit: int | None) -> tuple[Query, ...]:
    """All queries, or so many of them, evenly spread."""
    return dataset.queries if limit is None else tuple(thinned(dataset.queries, limit))


def localize_queries(
    dataset: Dataset,
    queries: Sequence[Query],
    paths: ScenePaths,
    settings: BenchmarkSettings,
    progress: bool,
    variant: str = "",
    localizer: LocalizerSettings | None = None,
) -> tuple[list[Detail], str]:
    """The details of the queries, and who worked; poses are written for the benchmark itself."""
    instructions = Instructions.of(
        paths.map,
        dataset.query_folder or dataset.image_folder,
        localizer or settings.localizer,
        settings.matcher,
        settings.backend,
        timeout=settings.timeout,
    )
    files = ListFiles(paths.details(variant))
    if not variant:
        files = replace(files, final=paths.poses("final"), coarse=paths.poses("coarse"))
    return localize_to_files(
        instructions,
        queries,
        files,
        settings.workers,
        settings.scheduler,
        settings.resume,
        progress,
    )


def _setup(
    dataset: Dataset, queries: Sequence[Query], settings: BenchmarkSettings, worked: str
) -> dict[str, str]:
    split = dataset.split
    if len(queries) < len(dataset.queries):
        split = f"{split}, {len(queries)} of {len(dataset.queries)} queries"
    return {
        "version": version("gscpe"),
        "split": split,
        "references": str(len(dataset.references)),
        "matcher": matcher_name(settings.matcher),
        "retrieval": settings.retrieval,
        "workers": worked,
        "cores": str(available_cores()),
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
    }


def _write_truths(run: SceneRun, queries: Sequence[Query], paths: ScenePaths) -> None:
    """The true poses of the queries, so that the poses can be evaluated again."""
    for name, truth in run.truths.items():
        known = {query.name: truth[query.name] for query in queries if query.name in truth}
        write_pose_file(paths.truth(name), known, "hloc")
