# SPDX-License-Identifier: Apache-2.0
"""Frames with their times: of videos, photos, cameras and robots' recordings."""

from gscpe.sequences.ahead import ReadAhead
from gscpe.sequences.camera import read_camera
from gscpe.sequences.frame import Frame, Frames, stamp_text
from gscpe.sequences.open_frames import open_frames
from gscpe.sequences.real_time import Clock, InRealTime
from gscpe.sequences.ros_messages import read_ros_camera, read_ros_image
from gscpe.sequences.video import VIDEO_ENDINGS, OpenedVideo

__all__ = [
    "VIDEO_ENDINGS",
    "Clock",
    "Frame",
    "Frames",
    "InRealTime",
    "OpenedVideo",
    "ReadAhead",
    "open_frames",
    "read_camera",
    "read_ros_camera",
    "read_ros_image",
    "stamp_text",
]
