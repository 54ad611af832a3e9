# SPDX-License-Identifier: Apache-2.0
"""Algorithm 2 of the paper, with Lucas-Kanade in place of Adam."""

from gscpe.refinement.exposure import ClippingSettings
from gscpe.refinement.illumination import IlluminationSettings
from gscpe.refinement.light import LightSettings
from gscpe.refinement.loop import refine_pose
from gscpe.refinement.lucas_kanade import Alignment
from gscpe.refinement.observer import RefinementObserver
from gscpe.refinement.result import RefinementResult
from gscpe.refinement.settings import RefinementSettings
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.uncertainty import PoseUncertainty, UncertaintySettings
from gscpe.refinement.visibility import VisibilitySettings

__all__ = [
    "Alignment",
    "ClippingSettings",
    "IlluminationSettings",
    "LightSettings",
    "LucasKanadeSettings",
    "PoseUncertainty",
    "RefinementObserver",
    "RefinementResult",
    "RefinementSettings",
    "UncertaintySettings",
    "VisibilitySettings",
    "refine_pose",
]
