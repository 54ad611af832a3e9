"""Settings of the pipeline."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from gscpe.coarse import CoarseSettings, FocalSettings
from gscpe.errors import SettingsError
from gscpe.refinement import RefinementSettings
from gscpe.retrieval import IndexSettings
from gscpe.verification import VerificationSettings


@dataclass(frozen=True)
class LocalizerSettings:
    """Settings of every stage.

    Attributes:
        hypotheses: places that are tried, best first, until one is not doubted.
        retrieved: references that are retrieved to find so many different places.
        same_place: metres between cameras, looking the same way, that show one place.
        near: a prior whose deviation is at most this, metres, is refined at once, ...
        near_degrees: ... and whose rotation is as sure as this.
        near_levels: times the image is halved for it; each doubles how far off it may be.
        index: how the references are searched.
        retrieval_model: path of the exported network that described the map's references,
            where one did; None: the file of its name in gscpe.retrieval.descriptors_folder().
    """

    hypotheses: int = 3
    retrieved: int = 20
    same_place: float = 0.5
    near: float = 0.1
    near_degrees: float = 4.0
    near_levels: int = 4
    index: IndexSettings = field(default_factory=IndexSettings)
    retrieval_model: str | Path | None = None
    coarse: CoarseSettings = field(default_factory=CoarseSettings)
    focal: FocalSettings = field(default_factory=FocalSettings)
    refinement: RefinementSettings = field(default_factory=RefinementSettings)
    verification: VerificationSettings = field(default_factory=VerificationSettings)

    def __post_init__(self) -> None:
        if not 1 <= self.hypotheses <= self.retrieved:
            raise SettingsError(
                "at least one place must be tried, and as many references retrieved, not "
                f"{self.hypotheses} and {self.retrieved}"
            )
