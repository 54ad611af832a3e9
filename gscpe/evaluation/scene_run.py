# SPDX-License-Identifier: Apache-2.0
"""What came of localizing the queries of one scene, beside the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Mapping

from gscpe.arrays import Float64Array, short_repr
from gscpe.evaluation.metrics import Evaluation, evaluate
from gscpe.geometry.pose_error import PoseDifference, pose_difference
from gscpe.poses.hloc import parse_pose

Stage = Literal["coarse", "aligned", "final"]


@dataclass(frozen=True, eq=False)
class SceneRun:
    """The queries of one scene, localized.

    Attributes:
        dataset: its name, for example "7-Scenes".
        scene: for example "redkitchen".
        details: one per query, in the order of the list; see docs/formats.md, "Details".
        truths: name of a ground truth -> photo name -> ``cam_from_world``, (4, 4); the first is
            the one that the map's references are of.
        metres_per_unit: of all poses; None where it is not known.
        setup: what it ran with, for people: version, matcher, renderer, cores, ...
    """

    dataset: str
    scene: str
    details: tuple[Mapping[str, Any], ...]
    truths: Mapping[str, Mapping[str, Float64Array]]
    metres_per_unit: float | None
    setup: Mapping[str, str]

    def __repr__(self) -> str:
        return short_repr(self)

    def poses(self, stage: Stage) -> dict[str, Float64Array]:
        """``cam_from_world``, (4, 4), of the localized photos by name: the final poses, or
        those of one stage alone."""
        poses = {}
        for detail in self.details:
            source = detail if stage == "final" else detail[stage]
            if detail["status"] == "localized" and source is not None:
                poses[str(detail["name"])] = parse_pose(source["cam_from_world"])
        return poses

    @property
    def truth(self) -> Mapping[str, Float64Array]:
        """``cam_from_world``, (4, 4), by photo name, of the first ground truth; empty where there
        is none."""
        return next(iter(self.truths.values()), {})

    def knows(self, truth: str) -> bool:
        """Whether a ground truth knows the pose of any of the queries."""
        return any(str(detail["name"]) in self.truths[truth] for detail in self.details)

    def errors(self, stage: Stage) -> dict[str, PoseDifference]:
        """By name, of the localized photos that the first ground truth knows; distances in
        metres where the map's unit is known, else in world units."""
        unit, errors = self.metres_per_unit or 1.0, {}
        for name, pose in self.poses(stage).items():
            if name in self.truth:
                error = pose_difference(pose, self.truth[name])
                errors[name] = PoseDifference(unit * error.distance, error.degrees)
        return errors

    def evaluate(self, stage: Stage, truth: str | None = None) -> Evaluation:
        """The errors of a stage against one of the ground truths (None: the first).

        Photos that the truth does not know are left out; distances are in metres where the
        map's unit is known, else in world units.
        """
        known = self.truths[next(iter(self.truths)) if truth is None else truth]
        asked = {str(detail["name"]) for detail in self.details}
        return evaluate(
            {name: pose for name, pose in self.poses(stage).items() if name in known},
            {name: pose for name, pose in known.items() if name in asked},
            self.metres_per_unit or 1.0,
        )
