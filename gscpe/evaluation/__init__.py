"""Errors against known poses, tables, and data with known answers."""

from gscpe.evaluation.metrics import THRESHOLDS, Evaluation, evaluate, normalized_error_squared

__all__ = ["THRESHOLDS", "Evaluation", "evaluate", "normalized_error_squared"]
