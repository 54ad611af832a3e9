# SPDX-License-Identifier: Apache-2.0
"""What the paper GS-CPE reports, to stand beside our own numbers.

H. Weng, C. M. Yeum, S.-M. Kang: "GS-CPE: Unified 6-Degree-of-Freedom Camera Pose Estimation
via 3D Gaussian Splatting", arXiv:2608.10938. Only numbers that we have read are here; scenes
that are missing were reported, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gscpe.evaluation.scene_run import SceneRun

METHOD = "GS-CPE"
SOURCE = "arXiv:2608.10938"
DATASET = "7-Scenes"
TRUTH = "sfm"
"""The paper's ground truth: the SfM poses of Brachmann et al. (ICCV 2021)."""
SPLIT = "official"
"""The sequences of TrainSplit.txt and TestSplit.txt."""

SCENES = ("chess", "fire", "heads", "office", "pumpkin", "redkitchen", "stairs")
"""Over which the paper's average is."""

MACHINE = "RTX A5000"


@dataclass(frozen=True)
class PublishedError:
    """Median errors of one stage; ``scene`` is None for the average of SCENES."""

    stage: Literal["coarse", "final"]
    scene: str | None
    centimetres: float
    degrees: float


ERRORS = (
    PublishedError("coarse", None, 1.08, 0.31),
    PublishedError("coarse", "redkitchen", 0.74, 0.32),
    PublishedError("final", None, 0.91, 0.29),
    PublishedError("final", "redkitchen", 0.72, 0.27),
)

SECONDS = {"coarse": 1.255, "refinement": 0.353, "total": 1.608}
"""Of a query, by stage, on MACHINE; features and retrieval are not given apart."""

ABLATION = (
    ("full", 1.02, 0.184),
    ("without multi-scale", 1.08, 0.197),
    ("without mask", 1.14, 0.191),
)
"""On Office: what is left out, median centimetres, median degrees."""
ABLATION_SCENE = "office"


def same_photos(run: SceneRun) -> bool:
    """Whether a run is of the paper's data set, with the paper's split."""
    return run.dataset == DATASET and run.setup.get("split") == SPLIT


def error_of(stage: str, scene: str | None) -> PublishedError | None:
    """The reported errors of a stage in a scene, or on average (None)."""
    for error in ERRORS:
        if (error.stage, error.scene) == (stage, scene):
            return error
    return None
