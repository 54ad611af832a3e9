# SPDX-License-Identifier: Apache-2.0
"""XFeat: mutual nearest neighbours, polished to sub-pixel."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import NoneType

from gscpe.arrays import BoolArray, UInt8Array
from gscpe.features.xfeat import XFeat, XFeatFeatures
from gscpe.matching.nearest import mutual_nearest
from gscpe.matching.polish import PolishSettings, for_polishing, polish
from gscpe.matching.protocol import Matches, no_matches
from gscpe.ranges import check_kinds, check_numbers, check_whole


@dataclass(frozen=True)
class XFeatMatcherSettings:
    """How images are matched.

    Attributes:
        max_features: at most this many an image, best first.
        min_cosine: least similarity of two descriptors.
        polish: None leaves the matches where the network put them.
    """

    max_features: int = 4096
    min_cosine: float = 0.82
    polish: PolishSettings | None = field(default_factory=PolishSettings)

    def __post_init__(self) -> None:
        check_whole(self, "max_features", least=1)
        check_numbers(self, "min_cosine", least=-1, below=1)
        check_kinds(self, polish=(PolishSettings, NoneType))


@dataclass(frozen=True, eq=False)
class XFeatImage:
    """What is kept of an image between preparing and matching.

    Attributes:
        features: at most as many as the settings say.
        size: width and height of the image in pixels.
        normalized: (H, W) uint8, its locally normalized luminance; None: not to be polished.
    """

    features: XFeatFeatures
    size: tuple[int, int]
    normalized: UInt8Array | None


class XFeatMatcher:
    """Implements :class:`gscpe.matching.Matcher`."""

    def __init__(
        self, settings: XFeatMatcherSettings | None = None, network: XFeat | None = None
    ) -> None:
        """Opens the installed network, unless one is given.

        Raises:
            ModelError: XFeat is not installed (``gscpe models install xfeat``), or damaged.
            MissingDependencyError: onnxruntime is not installed.
        """
        self._settings = settings or XFeatMatcherSettings()
        self._network = network or XFeat()

    def prepare(self, rgb: UInt8Array, valid: BoolArray | None) -> XFeatImage:
        settings = self._settings
        return prepare_image(self._network, rgb, valid, settings.max_features, settings.polish)

    def match(self, photo: XFeatImage, render: XFeatImage) -> Matches:
        if not len(photo.features) or not len(render.features):
            return no_matches()
        cosine = photo.features.descriptors @ render.features.descriptors.T
        rows, columns = mutual_nearest(cosine)
        scores = cosine[rows, columns]
        kept = scores > self._settings.min_cosine
        photo_pixels = photo.features.pixels[rows[kept]]
        render_pixels = render.features.pixels[columns[kept]]
        render_pixels = polish(
            photo.normalized, render.normalized, photo_pixels, render_pixels, self._settings.polish
        )
        return Matches(photo_pixels, render_pixels, scores[kept])


def prepare_image(
    network: XFeat,
    rgb: UInt8Array,
    valid: BoolArray | None,
    max_features: int,
    settings: PolishSettings | None,
) -> XFeatImage:
    """Features of an (H, W, 3) uint8 RGB image where ``valid``, (H, W), holds, and what
    polishing needs of it."""
    return XFeatImage(
        features=network.detect(rgb, max_features, valid=valid),
        size=(rgb.shape[1], rgb.shape[0]),
        normalized=for_polishing(rgb, settings),
    )
