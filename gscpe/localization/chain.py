# SPDX-License-Identifier: Apache-2.0
"""What is tried for a photo: starts, coarse stage, refinement, and whether to trust it."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from itertools import islice
from typing import Iterator, Sequence

from gscpe.arrays import Float64Array
from gscpe.coarse import estimate_coarse_pose
from gscpe.localization.attempt import Attempt, PreparedPhoto
from gscpe.localization.observer import Observer
from gscpe.localization.places import Places
from gscpe.localization.settings import LocalizerSettings
from gscpe.localization.starts import PosePrior, Start
from gscpe.localization.turns import turned_back, turned_photo
from gscpe.localization.verification import (
    doubt_about_aligned,
    doubt_about_coarse,
    doubt_about_tracked,
)
from gscpe.matching import Matcher, SiftMatcher
from gscpe.refinement import RefinementResult, RefinementSettings, refine_pose
from gscpe.render import Renderer
from gscpe.scene import Map, Photo

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Chain:
    """All stages for photos of one map; everything is with respect to the map's own frame.

    Attributes:
        map: the map.
        settings: of every stage.
        renderer: of the map's splat.
        matcher: of photo and render.
        places: where to begin.
    """

    map: Map
    settings: LocalizerSettings
    renderer: Renderer
    matcher: Matcher
    places: Places

    def attempts(
        self,
        query: PreparedPhoto,
        prior: PosePrior | None,
        references: Sequence[str] | None,
        observer: Observer,
    ) -> Iterator[Attempt]:
        """What comes of each start; at last, of the photo turned by quarters, which learned
        features do not recognize."""
        trusted = False
        for start in self.places.starts(query, prior, references):
            attempt = self._attempt(query, start, prior, observer)
            _log.debug("from %s %s: %s", start.kind, start.reference or "", attempt.doubt or "ok")
            trusted = trusted or attempt.doubt is None
            yield attempt
        if trusted:
            return
        for turned in self.turned(query):
            for start in self.turned_starts(turned, references):
                attempt = self._attempt(turned, start, None, observer)
                _log.debug("turned %d, %s: %s", turned.orientation, start.reference, attempt.doubt)
                yield turned_back(attempt, turned)

    def turned(self, query: PreparedPhoto) -> Iterator[PreparedPhoto]:
        if not len(self.map.references) or isinstance(self.matcher, SiftMatcher):
            return  # there is nothing that is upright; or turns do not matter
        for orientation in self.settings.orientations:
            photo = turned_photo(query.photo, orientation)
            yield PreparedPhoto(photo, self.matcher, query.clock, orientation)

    def turned_starts(
        self, turned: PreparedPhoto, references: Sequence[str] | None = None
    ) -> Iterator[Start]:
        return islice(self.places.starts(turned, None, references), self.settings.turned_hypotheses)

    def _attempt(
        self, query: PreparedPhoto, start: Start, prior: PosePrior | None, observer: Observer
    ) -> Attempt:
        settings, clock = self.settings, query.clock
        if start.kind == "tracking":
            assert prior is not None
            with clock.stage("refinement"):
                refinement = replace(settings.refinement, levels=settings.tracking_levels)
                aligned = self._refine(query.photo, start.cam_from_world, refinement, observer)
            doubt = doubt_about_tracked(prior, aligned, settings.verification, self.map.frame)
            return Attempt(start, None, aligned, doubt)
        prepared = query.for_matching
        with clock.stage("coarse"):
            coarse = estimate_coarse_pose(
                self.renderer,
                self.matcher,
                prepared,
                query.photo.camera,
                start.cam_from_world,
                settings.coarse,
                observer,
            )
        doubt = doubt_about_coarse(coarse, query.photo.camera, settings.verification)
        if doubt is not None or coarse.cam_from_world is None:
            return Attempt(start, coarse, None, doubt)
        with clock.stage("refinement"):
            aligned = self._refine(
                query.photo, coarse.cam_from_world, settings.refinement, observer
            )
        doubt = doubt_about_aligned(
            coarse, aligned, settings.verification, settings.fusion, self.map.frame
        )
        return Attempt(start, coarse, aligned, doubt)

    def _refine(
        self,
        photo: Photo,
        cam_from_world: Float64Array,
        settings: RefinementSettings,
        observer: Observer,
    ) -> RefinementResult:
        return refine_pose(self.renderer, photo, cam_from_world, settings, observer)

    def is_sure(self, attempt: Attempt) -> bool:
        sure = self.settings.verification.sure_agreement
        return attempt.aligned is not None and attempt.aligned.agreement >= sure
