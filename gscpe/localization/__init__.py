# SPDX-License-Identifier: Apache-2.0
"""One photo: where to begin, attempts, their fusion, and whether the pose can be trusted."""

from gscpe.localization.attempt import Attempt
from gscpe.localization.easy import EasySettings
from gscpe.localization.fusion import FusionSettings, fuse_matches_and_alignment
from gscpe.localization.localizer import Localizer
from gscpe.localization.observer import Observer
from gscpe.localization.result import LocalizationResult
from gscpe.localization.settings import LocalizerSettings
from gscpe.localization.starts import PosePrior, Start
from gscpe.localization.verification_settings import VerificationSettings
from gscpe.localization.wrong_camera import CameraCheckSettings

__all__ = [
    "Attempt",
    "CameraCheckSettings",
    "EasySettings",
    "FusionSettings",
    "LocalizationResult",
    "Localizer",
    "LocalizerSettings",
    "Observer",
    "PosePrior",
    "Start",
    "VerificationSettings",
    "fuse_matches_and_alignment",
]
