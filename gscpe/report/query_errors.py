"""The errors of single queries, which the tables' medians hide."""

from __future__ import annotations

from typing import Any, Mapping

from gscpe.arrays import Float64Array
from gscpe.evaluation import SceneRun, Stage
from gscpe.geometry.pose_error import PoseDifference, pose_difference
from gscpe.scene.poses.hloc import parse_pose

STAGES: tuple[Stage, ...] = ("coarse", "aligned", "final")

Errors = Mapping[str, Mapping[str, PoseDifference]]
"""By stage, then by photo name; distances in metres where the map's unit is known, else in map
units. Only of localized photos that the first ground truth knows."""


def errors_by_stage(run: SceneRun) -> Errors:
    """The errors of all queries."""
    return {stage: _errors(run, stage) for stage in STAGES}


def _errors(run: SceneRun, stage: Stage) -> dict[str, PoseDifference]:
    known = true_poses(run)
    unit = run.metres_per_unit or 1.0
    errors = {}
    for name, pose in run.poses(stage).items():
        if name in known:
            error = pose_difference(pose, known[name])
            errors[name] = PoseDifference(unit * error.distance, error.degrees)
    return errors


def true_poses(run: SceneRun) -> Mapping[str, Float64Array]:
    """``cam_from_world``, (4, 4), by photo name, of the first ground truth; empty where there is
    none."""
    return next(iter(run.truths.values()), {})


def shown_pose(detail: Mapping[str, Any]) -> Float64Array | None:
    """Where a query is shown from: its final pose; where it was not localized, the last pose
    that was found and not trusted, coarse before aligned; None where there is none."""
    for source in (detail, detail["coarse"], detail["aligned"]):
        if source is not None and source["cam_from_world"] is not None:
            return parse_pose(source["cam_from_world"])
    return None
