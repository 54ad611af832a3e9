# SPDX-License-Identifier: Apache-2.0
"""Photos or videos put together to a model of a place (structure from motion, by pycolmap)."""

from gscpe.reconstruction.frame import ModelFrame
from gscpe.reconstruction.known_poses import KnownPoses
from gscpe.reconstruction.lengths import KnownLengths, read_lengths
from gscpe.reconstruction.reconstruct import reconstruct
from gscpe.reconstruction.refine_poses import refine_known_poses
from gscpe.reconstruction.result import Reconstruction, RefinedPoses
from gscpe.reconstruction.scale import ScaleSource
from gscpe.reconstruction.settings import PoseRefinementSettings, ReconstructionSettings
from gscpe.reconstruction.sharpness import sharpness
from gscpe.reconstruction.work_folder import not_kept_if_refused, open_work_folder

__all__ = [
    "KnownLengths",
    "KnownPoses",
    "ModelFrame",
    "PoseRefinementSettings",
    "Reconstruction",
    "ReconstructionSettings",
    "RefinedPoses",
    "ScaleSource",
    "not_kept_if_refused",
    "open_work_folder",
    "read_lengths",
    "reconstruct",
    "refine_known_poses",
    "sharpness",
]
