# SPDX-License-Identifier: Apache-2.0
"""Photos or videos put together to a model of a place (structure from motion, by pycolmap)."""

from gscpe.reconstruction.frame import ModelFrame
from gscpe.reconstruction.reconstruct import Reconstruction, reconstruct
from gscpe.reconstruction.scale import ScaleSource
from gscpe.reconstruction.settings import ReconstructionSettings
from gscpe.reconstruction.sharpness import sharpness
from gscpe.reconstruction.work_folder import open_work_folder

__all__ = [
    "ModelFrame",
    "Reconstruction",
    "ReconstructionSettings",
    "ScaleSource",
    "open_work_folder",
    "reconstruct",
    "sharpness",
]
