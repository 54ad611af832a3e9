# SPDX-License-Identifier: Apache-2.0
"""Making maps: from a trained splat and its photos, from a splat alone, or from one RGB-D photo;
and whether they are good: whether splat and poses fit, and whether references come back to their
own poses."""

from gscpe.mapping.frame_check import check_frames, measure_misfit, with_fitting_axes
from gscpe.mapping.from_rgbd import RgbdMapSettings, map_from_rgbd, scene_from_rgbd
from gscpe.mapping.from_splat import MapSettings, build_map, map_without_references
from gscpe.mapping.map_check import CheckedReference, MapCheck, check_map
from gscpe.mapping.misfit import Misfit
from gscpe.mapping.settings import FrameCheckSettings, MapCheckSettings
from gscpe.mapping.transform_file import read_transform
from gscpe.mapping.virtual_references import map_with_virtual_references

__all__ = [
    "CheckedReference",
    "FrameCheckSettings",
    "MapCheck",
    "MapCheckSettings",
    "MapSettings",
    "Misfit",
    "RgbdMapSettings",
    "build_map",
    "check_frames",
    "check_map",
    "map_from_rgbd",
    "map_with_virtual_references",
    "map_without_references",
    "measure_misfit",
    "read_transform",
    "scene_from_rgbd",
    "with_fitting_axes",
]
