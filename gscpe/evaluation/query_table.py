# SPDX-License-Identifier: Apache-2.0
"""Every query of a run: what came of it, how far off it is, and how sure it is."""

from __future__ import annotations

from typing import Any, Mapping

import numpy as np

from gscpe.evaluation.metrics import expected_error
from gscpe.evaluation.scene_run import SceneRun, Stage
from gscpe.evaluation.table import Table
from gscpe.evaluation.text import NOTHING, number_text, significant_text
from gscpe.geometry.pose_error import PoseDifference

STAGES: tuple[Stage, ...] = ("coarse", "final")


def query_table(run: SceneRun) -> Table:
    """A row a query: errors against the first ground truth, and the standard deviation of the
    final pose; lengths in cm, or in world units where the unit is not known."""
    metric = run.metres_per_unit is not None
    unit = "cm" if metric else "units"
    errors = {stage: run.errors(stage) for stage in STAGES} if run.truths else {}
    names = [str(detail["name"]) for detail in run.details]
    values = [
        [errors[stage].get(name) for stage in errors] + [_deviation(detail, run)]
        for name, detail in zip(names, run.details, strict=True)
    ]
    header = (
        *("photo", "status, reason"),
        *(f"{stage} position, {unit}" for stage in errors),
        f"position sd, {unit}",
        *(f"{stage} rotation, °" for stage in errors),
        *("rotation sd, °", "inliers", "agreement", "seconds", "reference"),
    )
    rows, records = [], []
    for name, detail, known in zip(names, run.details, values, strict=True):
        coarse, aligned = detail["coarse"] or {}, detail["aligned"] or {}
        seconds = detail["seconds"].get("total")
        status = str(detail["status"])
        rows.append(
            (
                name,
                status if detail["reason"] is None else f"{status}: {detail['reason']}",
                *(_length(error, metric) for error in known),
                *(number_text(None if error is None else error.degrees, 3) for error in known),
                f"{coarse['inliers']}" if "inliers" in coarse else NOTHING,
                number_text(aligned.get("agreement"), 2),
                number_text(seconds, 2),
                str(detail["reference"] or NOTHING),
            )
        )
        record: dict[str, Any] = {"photo": name, "status": status, "reason": detail["reason"]}
        for what, error in zip((*errors, "sd"), known, strict=True):
            length = None if error is None else (100.0 if metric else 1.0) * error.distance
            record[f"{what}_position_{unit}"] = length
            record[f"{what}_rotation_degrees"] = None if error is None else error.degrees
        records.append(record | {"seconds": seconds})
    return Table(
        "All queries",
        header,
        tuple(rows),
        records=tuple(records),
        words=("status, reason", "reference"),
        keys=tuple(
            "localized" if detail["status"] == "localized" else "refused" for detail in run.details
        ),
        tips={
            f"position sd, {unit}": "standard deviation of the camera centre, of the covariance",
            "rotation sd, °": "standard deviation of the rotation, of the covariance",
            "inliers": "matches that agree with the coarse pose",
            "agreement": "local correlation of photo and render at the aligned pose",
            "reference": "the reference photo where the search began",
        },
    )


def _deviation(detail: Mapping[str, Any], run: SceneRun) -> PoseDifference | None:
    if detail.get("covariance") is None:
        return None
    return expected_error(np.array(detail["covariance"]), run.metres_per_unit or 1.0)


def _length(error: PoseDifference | None, metric: bool) -> str:
    if error is None:
        return NOTHING
    return number_text(100.0 * error.distance, 2) if metric else significant_text(error.distance)
