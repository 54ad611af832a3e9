# SPDX-License-Identifier: Apache-2.0
"""XFeat features matched by LighterGlue, polished to sub-pixel."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import NoneType

from gscpe.arrays import BoolArray, UInt8Array
from gscpe.features.xfeat import XFeat
from gscpe.matching.lighterglue import LighterGlue
from gscpe.matching.polish import PolishSettings, polish
from gscpe.matching.protocol import Matches
from gscpe.matching.xfeat_matcher import XFeatImage, prepare_image
from gscpe.ranges import check_kinds, check_numbers, check_whole


@dataclass(frozen=True)
class LighterGlueMatcherSettings:
    """How images are matched.

    Attributes:
        max_features: at most this many an image, best first; time grows with the square.
        min_score: least probability of a match.
        polish: None leaves the matches where the network put them.
    """

    max_features: int = 1024
    min_score: float = 0.1
    polish: PolishSettings | None = field(default_factory=PolishSettings)

    def __post_init__(self) -> None:
        check_whole(self, "max_features", least=1)
        check_numbers(self, "min_score", least=0, below=1)
        check_kinds(self, polish=(PolishSettings, NoneType))


class LighterGlueMatcher:
    """Implements :class:`gscpe.matching.Matcher`."""

    def __init__(
        self,
        settings: LighterGlueMatcherSettings | None = None,
        features: XFeat | None = None,
        network: LighterGlue | None = None,
    ) -> None:
        """Opens the installed networks, unless they are given.

        Raises:
            ModelError: one is not installed (``gscpe models install xfeat``), or damaged.
            MissingDependencyError: onnxruntime is not installed.
        """
        self._settings = settings or LighterGlueMatcherSettings()
        self._features = features or XFeat()
        self._network = network or LighterGlue()

    def prepare(self, rgb: UInt8Array, valid: BoolArray | None) -> XFeatImage:
        settings = self._settings
        return prepare_image(self._features, rgb, valid, settings.max_features, settings.polish)

    def match(self, photo: XFeatImage, render: XFeatImage) -> Matches:
        settings = self._settings
        pairs, scores = self._network.match(
            photo.features,
            photo.size,
            render.features,
            render.size,
            min_score=settings.min_score,
            max_features=settings.max_features,
        )
        photo_pixels = photo.features.pixels[pairs[:, 0]]
        render_pixels = render.features.pixels[pairs[:, 1]]
        render_pixels = polish(
            photo.normalized, render.normalized, photo_pixels, render_pixels, settings.polish
        )
        return Matches(photo_pixels, render_pixels, scores)
