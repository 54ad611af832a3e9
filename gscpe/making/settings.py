# SPDX-License-Identifier: Apache-2.0
"""How maps are made of photos, and when they are good."""

from __future__ import annotations

from dataclasses import dataclass, field

from gscpe.errors import SettingsError
from gscpe.ranges import check_kinds, check_numbers, check_shares, check_test_every, check_whole
from gscpe.reconstruction import ReconstructionSettings
from gscpe.retrieval import parse_method


@dataclass(frozen=True)
class CertificateSettings:
    """When a map is good, usable or poor, by the photos that it was not made of.

    Attributes:
        good_localized: share of the left-out photos that a good map localizes, at least, ...
        good_error: ... with a median error of at most this share of the scene's size ...
        good_degrees: ... and this angle.
        usable_localized, usable_error, usable_degrees: the same of a usable map. One that is
            neither is poor.
        renders: that a map without photos is certified by.
        least_views: a Gaussian of a map without photos counts as seen where so many references
            show it; where the map has fewer than ten times as many, a tenth of them.
        good_seen, usable_seen: share of its Gaussians that are seen so, at least, of a good and of
            a usable map without photos.
        pictures: of so many photos, at most: the worst ones, and others evenly.
        picture_width: pixels, each.
        max_bytes: of the page.
    """

    good_localized: float = 0.9
    good_error: float = 0.002
    good_degrees: float = 0.25
    usable_localized: float = 0.6
    usable_error: float = 0.01
    usable_degrees: float = 1.0
    renders: int = 12
    least_views: int = 6
    good_seen: float = 0.95
    usable_seen: float = 0.5
    pictures: int = 12
    picture_width: int = 480
    max_bytes: int = 4_000_000

    def __post_init__(self) -> None:
        check_shares(self, "usable_localized", "good_localized", "usable_seen", "good_seen")
        check_numbers(self, "good_error", "good_degrees", "usable_error", "usable_degrees", above=0)
        check_whole(self, "pictures", least=0)
        check_whole(self, "picture_width", least=16)
        check_whole(self, "max_bytes", "renders", "least_views", least=1)
        if (
            self.usable_localized > self.good_localized
            or self.usable_seen > self.good_seen
            or self.good_error > self.usable_error
            or self.good_degrees > self.usable_degrees
        ):
            raise SettingsError(
                "a good map must localize, and its references show, at least the share of a usable "
                "one, with errors that are not above a usable one's"
            )


@dataclass(frozen=True)
class MakeMapSettings:
    """How long, how large, and what is left out.

    Attributes:
        reconstruction: how photos are put together.
        minutes: of training.
        iterations: instead of minutes: the same result every time.
        max_gaussians: of the splat.
        test_every: the first of so many photos is left out, to see how good the map is; 0: none.
        retrieval: see :class:`gscpe.MapSettings`.
        certificate: when the map is good.
        seed: of the training.

    Raises:
        SettingsError: a value is out of its range.
    """

    reconstruction: ReconstructionSettings = field(default_factory=ReconstructionSettings)
    minutes: float = 20.0
    iterations: int | None = None
    max_gaussians: int = 250_000
    test_every: int = 8
    retrieval: str = "vlad"
    certificate: CertificateSettings = field(default_factory=CertificateSettings)
    seed: int = 0

    def __post_init__(self) -> None:
        parse_method(self.retrieval)
        check_kinds(self, reconstruction=ReconstructionSettings, certificate=CertificateSettings)
        check_test_every(self.test_every)
        # What gscpe.training.TrainingSettings would refuse, hours later.
        check_numbers(self, "minutes", above=0, below=1e5)
        check_whole(self, "iterations", least=1, optional=True)
        check_whole(self, "max_gaussians", least=100)
        check_whole(self, "seed", least=0)
