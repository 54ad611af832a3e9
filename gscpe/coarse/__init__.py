"""Algorithm 1 of the paper: render, match, lift, PnP-RANSAC, and again."""

from gscpe.coarse.loop import CoarseResult, CoarseSettings, estimate_coarse_pose
from gscpe.coarse.pnp import PnPSettings

__all__ = ["CoarseResult", "CoarseSettings", "PnPSettings", "estimate_coarse_pose"]
