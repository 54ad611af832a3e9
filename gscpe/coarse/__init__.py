# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of the paper: render, match, lift, PnP-RANSAC, and again."""

from gscpe.coarse.intrinsics import CameraEstimate
from gscpe.coarse.lift import lift
from gscpe.coarse.loop import CoarseObserver, estimate_coarse_pose
from gscpe.coarse.one_round import CoarseResult, CoarseSettings, LikePhoto, Round, match_render
from gscpe.coarse.pnp import AbsolutePose, PnPSettings
from gscpe.coarse.rival import RivalSettings
from gscpe.coarse.unknown_intrinsics import (
    IntrinsicsSettings,
    estimate_intrinsics,
    probable_camera,
)

__all__ = [
    "AbsolutePose",
    "CameraEstimate",
    "CoarseObserver",
    "CoarseResult",
    "CoarseSettings",
    "IntrinsicsSettings",
    "LikePhoto",
    "PnPSettings",
    "RivalSettings",
    "Round",
    "estimate_coarse_pose",
    "estimate_intrinsics",
    "lift",
    "match_render",
    "probable_camera",
]
