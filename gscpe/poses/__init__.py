# SPDX-License-Identifier: Apache-2.0
"""Files of poses in the forms of hloc, COLMAP, TUM, 7-Scenes' pseudo ground truth, and JSON."""

from gscpe.poses.colmap_folder import COLMAP_FILES, complete_text_model, write_colmap_folder
from gscpe.poses.correspondence import MatchedBy, poses_by_name
from gscpe.poses.detect import POSE_FORMATS, PoseFormat, detect_format
from gscpe.poses.files import (
    PoseFile,
    format_of_path,
    is_colmap_folder,
    read_pose_file,
    write_pose_file,
)
from gscpe.poses.tum import photo_numbers

__all__ = [
    "COLMAP_FILES",
    "POSE_FORMATS",
    "MatchedBy",
    "PoseFile",
    "PoseFormat",
    "complete_text_model",
    "detect_format",
    "format_of_path",
    "is_colmap_folder",
    "photo_numbers",
    "poses_by_name",
    "read_pose_file",
    "write_colmap_folder",
    "write_pose_file",
]
