# SPDX-License-Identifier: Apache-2.0
"""The photo that is being localized, and what matchers make of it, once each."""

from __future__ import annotations

from typing import Any

from gscpe.features import XFeatFeatures
from gscpe.geometry.camera import Camera
from gscpe.localization.beside import Beside, Work
from gscpe.localization.clock import Clock
from gscpe.localization.light import well_lit
from gscpe.matching import LighterGlueMatcher, Matcher, XFeatMatcher
from gscpe.photos import Photo
from gscpe.photos.photo import resized_photo

_WORTH_WHILE = 1.5
"""Times by which a photo must be larger than that for a first look."""


class PreparedPhoto:
    """A photo that is being localized, and what matchers make of it once it is needed.

    Args:
        photo: turned, where it was; it is aligned as it is, and matched as if it were well lit.
        matcher: that comes first.
        clock: counts the time that is waited for features.
        orientation: how the photo was turned, EXIF's number.
        beside: prepares it while others work; None: when it is needed.
        small_side: pixels of the shorter side of a smaller photo for a first look; 0: none.
            Nor is there one where it would hardly be smaller.
    """

    def __init__(
        self,
        photo: Photo,
        matcher: Matcher,
        clock: Clock,
        orientation: int = 1,
        beside: Beside | None = None,
        small_side: int = 0,
    ) -> None:
        self.orientation = orientation
        self.photo = photo
        self.clock = clock
        self.has_moved = False  # whether matches of an attempt agreed on two poses
        self._matcher = matcher
        self._beside = beside
        self.well_lit = well_lit(photo)
        self._small = _smaller(self.well_lit, small_side)
        self._works: dict[tuple[object, bool], Work[Any]] = {}

    def begin(self) -> None:
        """Prepares it for the first matcher beside what follows."""
        if self._small is not None:
            self._work(self._matcher, small=True)
        self._work(self._matcher, small=False)

    @property
    def for_matching(self) -> Any:
        """``matcher.prepare(photo)`` of the first matcher, made once."""
        return self.prepared_for(self._matcher)

    @property
    def small_camera(self) -> Camera | None:
        """Of the photo for a first look; None where there is none."""
        return None if self._small is None else self._small.camera

    def prepared_for(self, matcher: Matcher, small: bool = False) -> Any:
        """``matcher.prepare(photo)``, or of the small photo, made once."""
        with self.clock.stage("features"):
            return self._work(matcher, small).result()

    def xfeat_features(self) -> XFeatFeatures | None:
        """XFeat's features of the photo, where the first matcher matches these."""
        if not isinstance(self._matcher, XFeatMatcher):
            return None
        features: XFeatFeatures = self.for_matching.features
        return features

    def _work(self, matcher: Matcher, small: bool) -> Work[Any]:
        # LighterGlue matches the best of the features that XFeat's matcher has.
        shared = isinstance(matcher, LighterGlueMatcher) and isinstance(self._matcher, XFeatMatcher)
        maker = self._matcher if shared else matcher
        photo = self._small if small and self._small is not None else self.well_lit
        key = (maker, photo is not self.well_lit)
        if key not in self._works:

            def prepare() -> Any:
                return maker.prepare(photo.rgb, photo.valid)

            self._works[key] = (
                Work(prepare, None) if self._beside is None else self._beside.begin(prepare)
            )
        return self._works[key]


def _smaller(photo: Photo, side: int) -> Photo | None:
    shorter = min(photo.camera.width, photo.camera.height)
    if side == 0 or shorter < _WORTH_WHILE * side:
        return None
    return resized_photo(photo, side / shorter)
