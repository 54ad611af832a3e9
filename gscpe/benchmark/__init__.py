# SPDX-License-Identifier: Apache-2.0
"""A scene of a data set from end to end: map, poses, tables and report."""

from gscpe.benchmark.ablation import PAPER_VARIANTS, run_ablation
from gscpe.benchmark.scene import ScenePaths, benchmark_scene
from gscpe.benchmark.settings import BenchmarkSettings

__all__ = [
    "PAPER_VARIANTS",
    "BenchmarkSettings",
    "ScenePaths",
    "benchmark_scene",
    "run_ablation",
]
