# SPDX-License-Identifier: Apache-2.0
"""Follows a camera at its frame rate: anchors that are kept, alignments, and the lost and found."""

from gscpe.tracking.motion import Motion
from gscpe.tracking.result import TrackingResult
from gscpe.tracking.settings import TrackingSettings, TrustSettings
from gscpe.tracking.tracker import Tracker

__all__ = ["Motion", "Tracker", "TrackingResult", "TrackingSettings", "TrustSettings"]
