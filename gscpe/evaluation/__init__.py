# SPDX-License-Identifier: Apache-2.0
"""Errors against known poses, and tables of them."""

from gscpe.evaluation.conventions import Explanation, explain_errors
from gscpe.evaluation.metrics import (
    THRESHOLDS,
    Evaluation,
    evaluate,
    expected_error,
    normalized_error_squared,
)
from gscpe.evaluation.scene_run import SceneRun, Stage

__all__ = [
    "THRESHOLDS",
    "Evaluation",
    "Explanation",
    "SceneRun",
    "Stage",
    "evaluate",
    "expected_error",
    "explain_errors",
    "normalized_error_squared",
]
