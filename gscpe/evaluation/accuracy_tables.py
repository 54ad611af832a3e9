# SPDX-License-Identifier: Apache-2.0
"""How exact a benchmark's poses are: median errors by scene, and shares within limits.

The paper's numbers stand beside ours only where data set, ground truth and split are
the paper's; a run says so with ``setup["split"] == "official"``.
"""

from __future__ import annotations

from typing import Any, Iterator, Sequence

import numpy as np

from gscpe.evaluation import published
from gscpe.evaluation.metrics import THRESHOLDS, Evaluation
from gscpe.evaluation.scene_run import SceneRun, Stage
from gscpe.evaluation.table import Table
from gscpe.evaluation.text import NOTHING, share_text

STAGES: tuple[Stage, ...] = ("coarse", "aligned", "final")
FINAL = "final: the mean of the coarse and the aligned pose by covariance"
MEDIANS = "medians are over the queries that have a pose; see the shares for all of them"
_AVERAGE = "average: mean of the scenes' medians"
_NO_UNIT = "u: world units, where a scene's unit in metres is not known"


def accuracy_table(dataset: str, truth: str, runs: Sequence[SceneRun]) -> Table:
    """Median errors: a row a stage, a column a scene; the average where there are several."""
    scenes = [run.scene for run in runs]
    rows, records = [], []
    final = [run.evaluate("final", truth) for run in runs]
    queries, localized = sum(r.queries for r in final), sum(r.localized for r in final)
    lost = f"{queries - localized} of {queries}"
    for stage in STAGES:
        results = [run.evaluate(stage, truth) for run in runs]
        cells = [_cell(run, result) for run, result in zip(runs, results, strict=True)]
        record: dict[str, Any] = {"stage": stage, "published": False, "scenes": {}}
        for run, result in zip(runs, results, strict=True):
            record["scenes"][run.scene] = {
                **_errors(run, result),
                "queries": result.queries,
                "with_pose": result.localized,
            }
        if len(runs) > 1:
            centimetres, degrees = _averages(runs, results)
            cells.append(_pair(centimetres, degrees))
            record["average"] = {
                "median_position_cm": centimetres,
                "median_rotation_degrees": degrees,
            }
        cells.append(lost)
        rows.append((stage, *cells))
        records.append(record)
    notes = [FINAL, MEDIANS, *_without_coarse(truth, runs)]
    if len(runs) > 1:
        notes.append(_AVERAGE)
    if any(run.metres_per_unit is None for run in runs):
        notes.append(_NO_UNIT)
    theirs = list(_published_rows(scenes)) if _is_the_papers(truth, runs) else []
    if theirs:
        notes.append(f"published: {published.METHOD}, {published.SOURCE}")
    unit = "world units" if all(run.metres_per_unit is None for run in runs) else "cm"
    keys = (*STAGES, *("published" for _ in theirs))
    rows += [row for row, _ in theirs]
    records += [record for _, record in theirs]
    return Table(
        f"{dataset}, ground truth {truth}: median position ({unit}) / rotation (°)",
        ("", *scenes, *(["average"] if len(runs) > 1 else []), "not localized"),
        tuple(rows),
        tuple(notes),
        tuple(records),
        keys=keys,
    )


def shares_table(dataset: str, truth: str, runs: Sequence[SceneRun]) -> Table:
    """Shares of all queries within each of THRESHOLDS, scene by scene and on average."""
    limits = [f"{100 * metres:.0f} cm / {degrees:.0f}°" for metres, degrees in THRESHOLDS]
    rows: list[tuple[str, ...]] = []
    records: list[dict[str, Any]] = []

    def add(scene: str, stage: str, shares: Sequence[float]) -> None:
        rows.append((f"{scene}, {stage}", *map(share_text, shares)))
        within = [
            {"position_cm": 100 * metres, "rotation_degrees": degrees, "share": float(share)}
            for (metres, degrees), share in zip(THRESHOLDS, shares, strict=True)
        ]
        records.append({"scene": scene, "stage": stage, "within": within})

    every: dict[str, list[Sequence[float]]] = {stage: [] for stage in STAGES}
    for run in runs:
        for stage in STAGES:
            result = run.evaluate(stage, truth)
            said = run.metres_per_unit is not None
            if stage == "coarse" and _tracked(run, truth):
                said = False
            every[stage].append(result.shares if said else (np.nan,) * len(THRESHOLDS))
            add(run.scene, stage, every[stage][-1])
    if len(runs) > 1:
        for each, shares in every.items():
            add("average", each, np.mean(shares, axis=0).tolist())
    return Table(
        f"{dataset}, ground truth {truth}: queries within",
        ("", *limits),
        tuple(rows),
        (
            FINAL,
            "a query without a pose counts as beyond every limit",
            *_without_coarse(truth, runs),
        ),
        tuple(records),
        keys=tuple(record["stage"] for record in records),
    )


def _is_the_papers(truth: str, runs: Sequence[SceneRun]) -> bool:
    return truth == published.TRUTH and all(published.same_photos(run) for run in runs)


def _published_rows(scenes: Sequence[str]) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """The paper's average stands only beside ours of the same scenes."""
    columns: list[str | None] = [*scenes]
    if len(scenes) > 1:
        columns.append(None)
    for stage in STAGES:
        errors = [
            None
            if scene is None and set(scenes) != set(published.SCENES)
            else published.error_of(stage, scene)
            for scene in columns
        ]
        if not any(errors):
            continue
        values = {
            scene: {"median_position_cm": e.centimetres, "median_rotation_degrees": e.degrees}
            for scene, e in zip(columns, errors, strict=True)
            if e is not None
        }
        record: dict[str, Any] = {"stage": stage, "published": True}
        record["scenes"] = {scene: value for scene, value in values.items() if scene is not None}
        if None in values:
            record["average"] = values[None]
        cells = [NOTHING if e is None else _pair(e.centimetres, e.degrees, 2) for e in errors]
        yield (f"{published.METHOD}, {stage} (published)", *cells, NOTHING), record


def _tracked(run: SceneRun, truth: str) -> int:
    """How many localized queries have no coarse pose: they were followed from a prior."""
    return run.evaluate("final", truth).localized - run.evaluate("coarse", truth).localized


def _without_coarse(truth: str, runs: Sequence[SceneRun]) -> Iterator[str]:
    count = sum(_tracked(run, truth) for run in runs)
    if count:
        yield f"coarse: without {count} localized queries that needed no coarse stage"


def _errors(run: SceneRun, result: Evaluation) -> dict[str, float]:
    if run.metres_per_unit is None:
        return {
            "median_position_units": result.median_distance,
            "median_rotation_degrees": result.median_degrees,
        }
    return {
        "median_position_cm": 100.0 * result.median_distance,
        "median_rotation_degrees": result.median_degrees,
    }


def _averages(runs: Sequence[SceneRun], results: Sequence[Evaluation]) -> tuple[float, float]:
    """Centimetres and degrees; NaN where a scene has none."""
    metric = all(run.metres_per_unit is not None for run in runs)
    centimetres = 100.0 * float(np.mean([r.median_distance for r in results]))
    degrees = float(np.mean([r.median_degrees for r in results]))
    return (centimetres if metric else float("nan")), degrees


def _cell(run: SceneRun, result: Evaluation) -> str:
    if run.metres_per_unit is not None:
        return _pair(100.0 * result.median_distance, result.median_degrees)
    if np.isnan(result.median_distance):
        return NOTHING
    return f"{result.median_distance:.4g} u / {result.median_degrees:.3f}"


def _pair(centimetres: float, degrees: float, digits: int = 3) -> str:
    if np.isnan(centimetres):
        return NOTHING
    return f"{centimetres:.{digits}f} / {degrees:.{digits}f}"
