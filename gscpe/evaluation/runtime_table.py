# SPDX-License-Identifier: Apache-2.0
"""How long queries took, by stage."""

from __future__ import annotations

from typing import Any, Iterator, Mapping, Sequence

import numpy as np

from gscpe.evaluation import published
from gscpe.evaluation.scene_run import SceneRun
from gscpe.evaluation.table import Table
from gscpe.evaluation.text import NOTHING, share_text

_TIMED = ("features", "retrieval", "coarse", "refinement", "total")


def runtime_table(runs: Sequence[SceneRun]) -> Table:
    """Seconds a query by stage, median / mean over the queries that reached it."""
    rows, records = [], []

    def add(name: str, details: Sequence[Mapping[str, Any]]) -> None:
        cells, record = [], {}
        for stage in _TIMED:
            seconds = [d["seconds"][stage] for d in details if stage in d["seconds"]]
            median = float(np.median(seconds)) if seconds else float("nan")
            mean = float(np.mean(seconds)) if seconds else float("nan")
            cells.append(f"{median:.3f} / {mean:.3f}" if seconds else NOTHING)
            record[stage] = {"median_s": median, "mean_s": mean, "queries": len(seconds)}
        rows.append((name, *cells))
        records.append({"name": name, "published": False, "stages": record})

    for run in runs:
        add(f"{run.dataset} {run.scene}", run.details)
    if len(runs) > 1:
        add("all", [detail for run in runs for detail in run.details])
    if runs and all(published.same_photos(run) for run in runs):
        seconds = [published.SECONDS.get(stage) for stage in _TIMED]
        name = f"{published.METHOD} on an {published.MACHINE} (published)"
        rows.append((name, *(NOTHING if s is None else f"{s:.3f}" for s in seconds)))
        stages = {stage: {"published_s": s} for stage, s in zip(_TIMED, seconds, strict=True)}
        records.append({"name": name, "published": True, "stages": stages})
    return Table(
        "Seconds per query: median / mean",
        ("", *_TIMED),
        tuple(rows),
        ("over the queries that reached a stage", *_setups(runs)),
        tuple(records),
    )


def stage_times_table(details: Sequence[Mapping[str, Any]]) -> Table:
    """One run's seconds in full: a row a stage, over the queries that reached it."""
    stages: dict[str, list[float]] = {}
    for detail in details:
        for stage, seconds in detail["seconds"].items():
            stages.setdefault(str(stage), []).append(float(seconds))
    # Last, whichever query came first.
    ordered = [stage for stage in stages if stage != "total"] + ["total"] * ("total" in stages)
    whole = max((sum(seconds) for seconds in stages.values()), default=0.0) or 1.0
    rows, records = [], []
    for stage in ordered:
        median, most, longest = np.quantile(stages[stage], [0.5, 0.9, 1.0]).tolist()
        share = sum(stages[stage]) / whole
        times = (f"{value:.3f}" for value in (median, most, longest))
        rows.append((stage, f"{len(stages[stage])}", *times, share_text(share)))
        records.append(
            {
                **{"stage": stage, "queries": len(stages[stage]), "median_s": median},
                **{"quantile_90_s": most, "longest_s": longest, "share": share},
            }
        )
    return Table(
        "Seconds per query, by stage",
        ("", "queries", "median", "90% within", "longest", "share of the time"),
        tuple(rows),
        ("over the queries that reached a stage",),
        tuple(records),
        keys=tuple("total" if stage == "total" else "" for stage in ordered),
    )


def _setups(runs: Sequence[SceneRun]) -> Iterator[str]:
    """What the runs ran with, once where it is the same for several."""
    scenes: dict[str, list[str]] = {}
    for run in runs:
        setup = ", ".join(f"{key} {run.setup[key]}" for key in sorted(run.setup))
        if setup:
            scenes.setdefault(setup, []).append(run.scene)
    for setup, names in scenes.items():
        yield setup if len(scenes) == 1 else f"{', '.join(names)}: {setup}"
