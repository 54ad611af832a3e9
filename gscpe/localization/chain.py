# SPDX-License-Identifier: Apache-2.0
"""What is tried for a photo, from what costs little to what costs much."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from itertools import islice
from typing import Iterator, Sequence

from gscpe.localization.attempt import Attempt
from gscpe.localization.clock import Clock
from gscpe.localization.matchers import Matchers
from gscpe.localization.observer import Observer
from gscpe.localization.places import Places
from gscpe.localization.prepared import PreparedPhoto
from gscpe.localization.settings import LocalizerSettings
from gscpe.localization.stages import Stages
from gscpe.localization.start_views import StartViews
from gscpe.localization.starts import PosePrior, Start
from gscpe.localization.turns import turned_back, turned_photo
from gscpe.matching import SiftMatcher
from gscpe.photos import Photo

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Chain:
    """Everything that is tried for photos of one map; all is with respect to the map's own frame.

    Attributes:
        settings: what is tried.
        matchers: of photo and render.
        places: where to begin.
        stages: of one attempt.
        references: how many photos the map has.
    """

    settings: LocalizerSettings
    matchers: Matchers
    places: Places
    stages: Stages
    references: int

    def prepared(self, photo: Photo, clock: Clock, orientation: int = 1) -> PreparedPhoto:
        """A photo, at the map's resolution, to be localized."""
        beside, easy = self.stages.beside, self.settings.easy
        side = easy.side if self.references >= easy.min_references else 0
        return PreparedPhoto(photo, self.matchers.first.matcher, clock, orientation, beside, side)

    def attempts(
        self,
        query: PreparedPhoto,
        prior: PosePrior | None,
        references: Sequence[str] | None,
        observer: Observer,
    ) -> Iterator[Attempt]:
        """What comes of each start; and as long as nothing can be trusted, of what costs more:
        LighterGlue, the photo turned by quarters, more places, SIFT."""
        views = StartViews(self.stages.renderer, query.photo.camera)
        begun = list[Start]()
        starts = self.places.starts(query, prior, references)
        learned = [name for name in self.matchers.others if name != "sift"]
        robust = [name for name in self.matchers.others if name == "sift"]
        steps = (
            self._at_first(query, starts, begun, views, prior, observer),
            self._again(query, begun, learned, views, observer),
            self._turned(query, references, observer),
            self._more_places(query, starts, learned, observer),
            self._again(query, begun, robust, views, observer),
        )
        for step in steps:
            trusted = False
            for attempt in step:
                _log.debug("%s", attempt)
                yield attempt
                trusted = trusted or attempt.doubt is None
            if trusted:
                return

    def _at_first(
        self,
        query: PreparedPhoto,
        starts: Iterator[Start],
        begun: list[Start],
        views: StartViews,
        prior: PosePrior | None,
        observer: Observer,
    ) -> Iterator[Attempt]:
        """With the first matcher, from as many places as the settings say; starts are kept in
        ``begun``, without that of tracking, which is also an unsure prior."""
        references = 0
        while references < self.settings.hypotheses and (start := next(starts, None)) is not None:
            references += start.kind == "reference"
            if start.kind == "tracking":
                assert prior is not None
                yield self.stages.track(query, start, prior, observer)
                continue
            begun.append(start)
            if self.matchers.others:
                views.keep(start.cam_from_world)
            yield self.stages.attempt(query, start, self.matchers.first, observer, views)

    def _again(
        self,
        query: PreparedPhoto,
        begun: Sequence[Start],
        names: Sequence[str],
        views: StartViews,
        observer: Observer,
    ) -> Iterator[Attempt]:
        """From the same starts with other matchers; one that cannot be opened is an attempt that
        says so."""
        for name in names if begun else ():
            matcher = self.matchers.open(name)
            if isinstance(matcher, str):
                yield Attempt(begun[0], None, None, f"{name} was not tried: {matcher}", 1, name)
            else:
                for start in begun:
                    yield self.stages.hard_attempt(query, start, matcher, observer, views)

    def _more_places(
        self,
        query: PreparedPhoto,
        starts: Iterator[Start],
        names: Sequence[str],
        observer: Observer,
    ) -> Iterator[Attempt]:
        """From the starts that are left, with the strongest of the matchers that can be used."""
        opened = [self.matchers.open(name) for name in names]
        usable = [matcher for matcher in opened if not isinstance(matcher, str)]
        matcher = usable[-1] if usable else self.matchers.first
        for start in starts:
            yield self.stages.hard_attempt(query, start, matcher, observer, self.stages.renderer)

    def _turned(
        self, query: PreparedPhoto, references: Sequence[str] | None, observer: Observer
    ) -> Iterator[Attempt]:
        for turned in self.turned(query):
            for start in self.turned_starts(turned, references):
                attempt = self.stages.attempt(
                    turned, start, self.matchers.first, observer, self.stages.renderer
                )
                yield turned_back(attempt, turned)

    def turned(self, query: PreparedPhoto) -> Iterator[PreparedPhoto]:
        """The photo turned by quarters, which learned features do not recognize."""
        if not self.references or isinstance(self.matchers.first.matcher, SiftMatcher):
            return  # there is nothing that is upright; or turns do not matter
        for orientation in self.settings.orientations:
            photo = turned_photo(query.photo, orientation)
            yield self.prepared(photo, query.clock, orientation)

    def turned_starts(
        self, turned: PreparedPhoto, references: Sequence[str] | None = None
    ) -> Iterator[Start]:
        return islice(self.places.starts(turned, None, references), self.settings.turned_hypotheses)

    def is_sure(self, attempt: Attempt) -> bool:
        sure = self.settings.verification.sure_agreement
        return attempt.aligned is not None and attempt.aligned.agreement >= sure
