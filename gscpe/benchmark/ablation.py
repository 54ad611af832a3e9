# SPDX-License-Identifier: Apache-2.0
"""The paper's ablation: the same queries with a part of the refinement left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gscpe.benchmark.scene import ScenePaths, chosen_queries, localize_queries
from gscpe.benchmark.settings import BenchmarkSettings
from gscpe.datasets import Dataset
from gscpe.evaluation import SceneRun
from gscpe.evaluation.ablation_table import AblationRow
from gscpe.refinement import RefinementSettings


def without_multi_scale(full: RefinementSettings) -> RefinementSettings:
    """Full-size images only."""
    return replace(full, levels=0)


def without_mask(full: RefinementSettings) -> RefinementSettings:
    """All pixels with a depth take part."""
    mask = replace(full.visibility, views=0, min_opacity=0.0, max_depth_step=np.inf)
    return replace(full, visibility=mask)


PAPER_VARIANTS = {
    "without multi-scale": without_multi_scale,
    "without mask": without_mask,
}
"""What the paper leaves out, by its name there."""


def run_ablation(
    dataset: Dataset,
    full: SceneRun,
    paths: ScenePaths,
    settings: BenchmarkSettings,
    progress: bool = False,
) -> tuple[AblationRow, ...]:
    """Median errors of the refinement, whole and with parts left out, by the first ground truth.

    They are those of the image alignment itself (``aligned``), since the final pose is its mean
    with the coarse pose, which hides what is left out.

    Args:
        dataset, paths, settings: of the benchmark, whose map is there.
        full: what came of it.
        progress: show bars.
    """
    queries = chosen_queries(dataset, settings.limit)
    runs: dict[str, SceneRun] = {"full": full}
    for name, change in PAPER_VARIANTS.items():
        localizer = replace(settings.localizer, refinement=change(settings.localizer.refinement))
        details, _ = localize_queries(dataset, queries, paths, settings, progress, name, localizer)
        runs[name] = replace(full, details=tuple(details))
    return tuple(_row(name, run) for name, run in runs.items())


def _row(name: str, run: SceneRun) -> AblationRow:
    found = run.evaluate("aligned")
    unit = 1.0 if run.metres_per_unit is None else 100.0
    return AblationRow(name, unit * found.median_distance, found.median_degrees)
