"""Algorithm 2 of the paper, with Lucas-Kanade in place of Adam."""

from gscpe.refinement.loop import RefinementResult, RefinementSettings, refine_pose
from gscpe.refinement.lucas_kanade import LucasKanadeSettings
from gscpe.refinement.visibility import VisibilitySettings

__all__ = [
    "LucasKanadeSettings",
    "RefinementResult",
    "RefinementSettings",
    "VisibilitySettings",
    "refine_pose",
]
