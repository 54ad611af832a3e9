# SPDX-License-Identifier: Apache-2.0
"""The tables of a benchmark: accuracy, shares within limits, runtime."""

from __future__ import annotations

from pathlib import Path
from typing import Iterator, Sequence

from gscpe.errors import DatasetError
from gscpe.evaluation.accuracy_tables import accuracy_table, shares_table
from gscpe.evaluation.runtime_table import runtime_table
from gscpe.evaluation.scene_run import SceneRun
from gscpe.evaluation.table import Table, to_json, to_latex, to_markdown, to_text
from gscpe.output_file import write_file


def write_tables(runs: Sequence[SceneRun], folder: str | Path, more: Sequence[Table] = ()) -> None:
    """Writes tables.txt, tables.md, tables.tex and tables.json.

    Args:
        runs: a scene each; the tables are in their order.
        folder: made as needed.
        more: tables that come after those of :func:`benchmark_tables`.

    Raises:
        DatasetError: two runs are of the same scene.
        OutputError: a file cannot be written.
    """
    tables = (*benchmark_tables(runs), *more)
    folder = Path(folder)
    for name, write in (
        ("tables.txt", to_text),
        ("tables.md", to_markdown),
        ("tables.tex", to_latex),
        ("tables.json", to_json),
    ):
        write_file(folder / name, write(tables).encode())


def benchmark_tables(runs: Sequence[SceneRun]) -> tuple[Table, ...]:
    """Those of :func:`accuracy_tables`, then runtime."""
    return (*accuracy_tables(runs), *((runtime_table(runs),) if runs else ()))


def accuracy_tables(runs: Sequence[SceneRun]) -> tuple[Table, ...]:
    """Median errors and shares within limits, two tables a data set and ground truth: no shares
    where no unit is known in metres, and a table without rows where no query is known."""
    tables = []
    for dataset, truth, group in _groups(runs):
        known = [run for run in group if run.knows(truth)]
        if known:
            tables.append(accuracy_table(dataset, truth, known))
            if any(run.metres_per_unit is not None for run in known):
                tables.append(shares_table(dataset, truth, known))
        if len(known) < len(group):
            scenes = ", ".join(run.scene for run in group if run not in known)
            note = f"{truth} has none of these photos of {scenes}: there are no errors"
            tables.append(Table(f"{dataset}, ground truth {truth}: {scenes}", ("",), (), (note,)))
    return tuple(tables)


def _groups(runs: Sequence[SceneRun]) -> Iterator[tuple[str, str, list[SceneRun]]]:
    """Data set, ground truth, and the runs that have both, in the order of the runs."""
    keys = dict.fromkeys((run.dataset, truth) for run in runs for truth in run.truths)
    for dataset, truth in keys:
        group = [run for run in runs if run.dataset == dataset and truth in run.truths]
        scenes = [run.scene for run in group]
        twice = [scene for scene in scenes if scenes.count(scene) > 1]
        if twice:
            raise DatasetError(f"{dataset} {twice[0]} was run twice; give one run for each scene")
        yield dataset, truth, group
