"""Errors against known poses, tables, and data with known answers."""

from gscpe.evaluation.metrics import THRESHOLDS, Evaluation, evaluate

__all__ = ["THRESHOLDS", "Evaluation", "evaluate"]
