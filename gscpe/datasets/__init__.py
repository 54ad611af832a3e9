# SPDX-License-Identifier: Apache-2.0
"""Public data sets and the user's own captures, in the folder layouts that they come in."""

from gscpe.datasets.cambridge import read_cambridge
from gscpe.datasets.colmap_split import read_colmap
from gscpe.datasets.dataset import Dataset
from gscpe.datasets.fast_livo2 import read_fast_livo2
from gscpe.datasets.nerfstudio import read_transforms
from gscpe.datasets.rgbd_folder import read_rgbd_folder
from gscpe.datasets.seven_scenes import read_seven_scenes

__all__ = [
    "Dataset",
    "read_cambridge",
    "read_colmap",
    "read_fast_livo2",
    "read_rgbd_folder",
    "read_seven_scenes",
    "read_transforms",
]
