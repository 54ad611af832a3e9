# SPDX-License-Identifier: Apache-2.0
"""A camera followed through a whole sequence: frames in, files of poses out."""

from gscpe.following.follow import Observes, Tally, follow
from gscpe.following.odometry import Odometry, read_odometry
from gscpe.following.outputs import TrackFiles, track_details
from gscpe.following.overlay import Overlay

__all__ = [
    "Observes",
    "Odometry",
    "Overlay",
    "Tally",
    "TrackFiles",
    "follow",
    "read_odometry",
    "track_details",
]
