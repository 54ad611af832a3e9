# SPDX-License-Identifier: Apache-2.0
"""Settings of a benchmark."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import NoneType

from gscpe.batch import TIMEOUT
from gscpe.errors import SettingsError
from gscpe.localization import LocalizerSettings
from gscpe.ranges import check_kinds, check_numbers, check_whole
from gscpe.report import ReportSettings
from gscpe.retrieval import parse_method


@dataclass(frozen=True)
class BenchmarkSettings:
    """How a scene is mapped, localized and reported.

    Attributes:
        localizer: settings of every stage.
        matcher: name; see :func:`gscpe.matching.make_matcher`.
        backend: see :class:`gscpe.render.Renderer`.
        retrieval: how references are described; see :class:`gscpe.mapping.MapSettings`.
        check_frames: refuse a splat that does not look like the references from their poses.
        workers: number of processes; None: chosen for this machine.
        scheduler: address of a Dask scheduler, instead of processes.
        timeout: seconds for a photo; see :class:`gscpe.batch.Instructions`.
        resume: keep the map and the poses that are still valid.
        limit: localize this many of the queries, evenly spread; None: all.
        report: of the HTML page; None: write none.
    """

    localizer: LocalizerSettings = field(default_factory=LocalizerSettings)
    matcher: str = "auto"
    backend: str = "auto"
    retrieval: str = "vlad"
    check_frames: bool = True
    workers: int | None = None
    scheduler: str | None = None
    timeout: float = TIMEOUT
    resume: bool = False
    limit: int | None = None
    report: ReportSettings | None = field(default_factory=ReportSettings)

    def __post_init__(self) -> None:
        check_kinds(
            self,
            localizer=LocalizerSettings,
            matcher=str,
            backend=str,
            check_frames=bool,
            scheduler=(str, NoneType),
            resume=bool,
            report=(ReportSettings, NoneType),
        )
        parse_method(self.retrieval)
        check_whole(self, "limit", "workers", least=1, optional=True)
        check_numbers(self, "timeout", above=0, infinite=True)
        if self.workers is not None and self.scheduler is not None:
            raise SettingsError("give workers or a scheduler, not both")
