# SPDX-License-Identifier: Apache-2.0
"""How maps are made of photos, and when they are good."""

from __future__ import annotations

from dataclasses import dataclass, field

from gscpe.errors import SettingsError
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
    pictures: int = 12
    picture_width: int = 480
    max_bytes: int = 4_000_000

    def __post_init__(self) -> None:
        if not 0 <= self.usable_localized <= self.good_localized <= 1:
            raise SettingsError(
                "shares lie in [0, 1], and a good map's is not below a usable one's"
            )
        if not (
            0 < self.good_error <= self.usable_error
            and 0 < self.good_degrees <= self.usable_degrees
        ):
            raise SettingsError("errors are positive, and a good map's not above a usable one's")
        if self.renders < 1:
            raise SettingsError("a certificate needs at least one render")
        if self.pictures < 0 or self.picture_width < 16 or self.max_bytes < 1:
            raise SettingsError("pictures need a width of at least 16 pixels")


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
        if self.test_every < 0 or self.test_every == 1:
            raise SettingsError(f"test_every must be 0, or 2 and more, not {self.test_every}")
        # What training would refuse, hours later.
        if not self.minutes > 0:
            raise SettingsError(f"minutes must be positive, not {self.minutes}")
        if self.iterations is not None and self.iterations < 1:
            raise SettingsError(f"iterations must be at least 1, not {self.iterations}")
        if self.max_gaussians < 1 or self.seed < 0:
            raise SettingsError(
                "max_gaussians must be at least 1 and seed at least 0, not "
                f"{self.max_gaussians} and {self.seed}"
            )
