# SPDX-License-Identifier: Apache-2.0
"""Gaussians and reference photos in one frame: a map, and the folder that keeps it."""

from gscpe.scene.map import Map
from gscpe.scene.map_folder import open_map, save_map
from gscpe.scene.map_frame import MapFrame
from gscpe.scene.references import DescriberModel, GlobalDescriptors, References

__all__ = [
    "DescriberModel",
    "GlobalDescriptors",
    "Map",
    "MapFrame",
    "References",
    "open_map",
    "save_map",
]
