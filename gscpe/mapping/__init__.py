"""Making maps: from a trained splat and its photos, or from one RGB-D photo."""

from gscpe.mapping.frame_check import check_frames, with_fitting_axes
from gscpe.mapping.from_rgbd import RgbdMapSettings, map_from_rgbd, scene_from_rgbd
from gscpe.mapping.from_splat import MapSettings, build_map, map_without_references

__all__ = [
    "MapSettings",
    "RgbdMapSettings",
    "build_map",
    "check_frames",
    "map_from_rgbd",
    "map_without_references",
    "scene_from_rgbd",
    "with_fitting_axes",
]
