# SPDX-License-Identifier: Apache-2.0
"""The map to look at: in a browser, or as a picture, with cameras and what was found of them."""

from gscpe.viewer.contents import Contents, Findings, Refused, Trajectory, contents_of
from gscpe.viewer.files import read_findings
from gscpe.viewer.live import Live
from gscpe.viewer.overview import OverviewSettings, overview
from gscpe.viewer.page import Viewer

__all__ = [
    "Contents",
    "Findings",
    "Live",
    "OverviewSettings",
    "Refused",
    "Trajectory",
    "Viewer",
    "contents_of",
    "overview",
    "read_findings",
]
