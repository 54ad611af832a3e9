"""Errors against known poses, tables, and data with known answers."""

from gscpe.evaluation.conventions import Explanation, explain_errors
from gscpe.evaluation.metrics import THRESHOLDS, Evaluation, evaluate, normalized_error_squared
from gscpe.evaluation.scene_run import SceneRun, Stage

__all__ = [
    "THRESHOLDS",
    "Evaluation",
    "Explanation",
    "SceneRun",
    "Stage",
    "evaluate",
    "explain_errors",
    "normalized_error_squared",
]
