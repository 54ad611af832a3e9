# SPDX-License-Identifier: Apache-2.0
"""Viewpoints in a splat that has no photos: free space, what is up, and where to look from."""

from gscpe.viewpoints.find import Viewpoints, find_viewpoints
from gscpe.viewpoints.settings import ViewpointSettings
from gscpe.viewpoints.surface import times_seen

__all__ = ["ViewpointSettings", "Viewpoints", "find_viewpoints", "times_seen"]
