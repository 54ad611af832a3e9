# SPDX-License-Identifier: Apache-2.0
"""Training of Gaussian splats from photos with known poses, on the CPU. Needs Numba."""

import importlib.util

from gscpe.errors import MissingDependencyError

if importlib.util.find_spec("numba") is None:
    raise MissingDependencyError("training needs Numba: pip install 'gscpe[cpu]'")

from gscpe.training.evaluation import Likeness, likeness
from gscpe.training.from_colmap import TrainedSplat, train_from_colmap
from gscpe.training.from_references import (
    checkpoint_of,
    split_references,
    train_references,
)
from gscpe.training.loop import train
from gscpe.training.points import PointCloud, read_colmap_points
from gscpe.training.progress import Progress, ProgressBar
from gscpe.training.settings import TrainingSettings
from gscpe.training.triangulation import triangulated_points

__all__ = [
    "Likeness",
    "PointCloud",
    "Progress",
    "ProgressBar",
    "TrainedSplat",
    "TrainingSettings",
    "checkpoint_of",
    "likeness",
    "read_colmap_points",
    "split_references",
    "train",
    "train_from_colmap",
    "train_references",
    "triangulated_points",
]
