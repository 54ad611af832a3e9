# SPDX-License-Identifier: Apache-2.0
"""Settings of the pipeline."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType

from gscpe.coarse import CoarseSettings, IntrinsicsSettings
from gscpe.errors import SettingsError
from gscpe.localization.easy import EasySettings
from gscpe.localization.fusion import FusionSettings
from gscpe.localization.verification_settings import VerificationSettings
from gscpe.ranges import check_kinds, check_numbers, check_whole
from gscpe.refinement import RefinementSettings
from gscpe.retrieval import IndexSettings

_ORIENTATIONS = frozenset(range(1, 9))
"""Of EXIF."""


@dataclass(frozen=True)
class LocalizerSettings:
    """Settings of every stage. Lengths are metres; where a map's unit is not known, they are for
    surfaces that are 2 m away.

    Attributes:
        hypotheses: number of places that are tried, best first, until a pose is trusted.
        retrieved: references that are retrieved at first to find that many different places; if
            they show fewer, more are retrieved.
        same_place: metres between cameras that show one place, where they look the same way, ...
        same_place_degrees: ... within this angle.
        orientations: turns (EXIF orientations) that are tried if a photo is not recognized; not
            with SIFT, which recognizes turned photos.
        turned_hypotheses: places that are tried in each.
        more_places: places that are tried after all this, one after the other.
        escalate: whether a photo that is not found with a matcher that was chosen by its name is
            tried with those that cost more: "xfeat", then "xfeat+lighterglue", then "sift".
        prior_sigmas: deviations of an unsure prior within which references are tried first.
        prior_degrees: of a prior whose rotation is less certain than this, only the position is
            used: a render from there would show something else than the photo.
        same_resolution: photos whose focal length in pixels is that of the references within this
            factor are not resampled.
        most_enlarged: a photo with fewer pixels is enlarged at most this much, because it contains
            no more detail.
        motion_sigma: where the result of the frame before is the prior: metres, standard deviation
            of the camera's motion since then, ...
        motion_sigma_degrees: ... and of its rotation.
        tracking_sigma: a prior whose deviation is at most this, metres, is aligned at once, ...
        tracking_sigma_degrees: ... and whose rotation is as sure as this.
        tracking_levels: times the image is halved for it; each doubles how far off it may be.
        index: how the references are searched.
        retrieval_model: path of the exported network that described the map's references,
            where one did; None: the file of its name in gscpe.retrieval.descriptors_folder().
    """

    hypotheses: int = 3
    retrieved: int = 20
    same_place: float = 0.5
    same_place_degrees: float = 30.0
    orientations: tuple[int, ...] = (6, 8, 3)
    turned_hypotheses: int = 1
    more_places: int = 3
    escalate: bool = True
    prior_sigmas: float = 3.0
    prior_degrees: float = 60.0
    same_resolution: float = 1.03
    most_enlarged: float = 2.0
    motion_sigma: float = 0.05
    motion_sigma_degrees: float = 2.0
    tracking_sigma: float = 0.1
    tracking_sigma_degrees: float = 4.0
    tracking_levels: int = 4
    index: IndexSettings = field(default_factory=IndexSettings)
    retrieval_model: str | Path | None = None
    easy: EasySettings = field(default_factory=EasySettings)
    coarse: CoarseSettings = field(default_factory=CoarseSettings)
    intrinsics: IntrinsicsSettings = field(default_factory=IntrinsicsSettings)
    refinement: RefinementSettings = field(default_factory=RefinementSettings)
    fusion: FusionSettings = field(default_factory=FusionSettings)
    verification: VerificationSettings = field(default_factory=VerificationSettings)

    def __post_init__(self) -> None:
        check_whole(self, "hypotheses", "retrieved", least=1)
        check_whole(self, "turned_hypotheses", "more_places", "tracking_levels", least=0)
        check_numbers(self, "same_place", "same_place_degrees", least=0, infinite=True)
        check_numbers(self, "same_resolution", "most_enlarged", least=1, infinite=True)
        check_numbers(self, "prior_sigmas", "prior_degrees", least=0, infinite=True)
        check_numbers(self, "motion_sigma", "motion_sigma_degrees", above=0)
        check_numbers(self, "tracking_sigma", "tracking_sigma_degrees", least=0, infinite=True)
        check_kinds(
            self,
            escalate=bool,
            retrieval_model=(str, Path, NoneType),
            index=IndexSettings,
            easy=EasySettings,
            coarse=CoarseSettings,
            intrinsics=IntrinsicsSettings,
            refinement=RefinementSettings,
            fusion=FusionSettings,
            verification=VerificationSettings,
        )
        if self.hypotheses > self.retrieved:
            raise SettingsError(
                "as many references must be retrieved as places are to be tried: retrieved is "
                f"{self.retrieved}, hypotheses {self.hypotheses}"
            )
        if not isinstance(self.orientations, tuple) or not set(self.orientations) <= _ORIENTATIONS:
            raise SettingsError(
                "LocalizerSettings.orientations must be a tuple of EXIF orientations, 1 to 8, not "
                f"{self.orientations!r}"
            )
