# SPDX-License-Identifier: Apache-2.0
"""How photos are put together."""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.errors import SettingsError
from gscpe.ranges import check_kinds, check_numbers, check_shares, check_whole


@dataclass(frozen=True)
class ReconstructionSettings:
    """What is matched with what, and how large.

    Attributes:
        max_size: longer side of the photos, pixels; larger ones are shrunk.
        frames: that are taken of all videos together.
        all_pairs_up_to: so many photos are all matched with each other.
        most_similar: of more, each with the photos that look most like it, ...
        in_order: ... and with so many that come after it, by name or in the video.
        max_features: of a photo.
        min_sharpness: see :func:`gscpe.reconstruction.sharpness`; where no photo reaches it, all
            are blurred.
        seed: of what is sampled.

    Raises:
        SettingsError: a value is out of its range.
    """

    max_size: int = 1000
    frames: int = 200
    all_pairs_up_to: int = 50
    most_similar: int = 20
    in_order: int = 5
    max_features: int = 8192
    min_sharpness: float = 0.08
    seed: int = 0

    def __post_init__(self) -> None:
        check_whole(self, "max_size", least=64)
        check_whole(self, "frames", least=3)
        check_whole(self, "all_pairs_up_to", "most_similar", "in_order", "seed", least=0)
        check_whole(self, "max_features", least=100)
        check_numbers(self, "min_sharpness", least=0)
        if self.most_similar + self.in_order < 1:
            raise SettingsError(
                "each photo must be matched with at least one other: most_similar and in_order are "
                "both 0"
            )


@dataclass(frozen=True)
class PoseRefinementSettings:
    """How known poses are refined.

    Attributes:
        first_error: how far points may be from their features at first, as a share of the photos'
            longer side, ...
        last_error: ... and at the end.
        rounds: at most; it ends where nothing moves any more.
        least_points: that a photo must see; with fewer, its pose is not refined.
        least_agreement: share of a photo's matches that must agree with its pose at the end.
        least_fit: share of all matches that must agree with the given poses within ``first_error``;
            with fewer, the poses are not these photos'.
        refine_focal_length: of the cameras, too.

    Raises:
        SettingsError: a value is out of its range.
    """

    first_error: float = 0.02
    last_error: float = 0.004
    rounds: int = 8
    least_points: int = 30
    least_agreement: float = 0.3
    least_fit: float = 0.5
    refine_focal_length: bool = False

    def __post_init__(self) -> None:
        check_numbers(self, "first_error", "last_error", above=0, below=1)
        check_whole(self, "rounds", least=1)
        check_whole(self, "least_points", least=4)
        check_shares(self, "least_agreement", "least_fit")
        check_kinds(self, refine_focal_length=bool)
        if self.last_error > self.first_error:
            raise SettingsError(
                f"last_error must not be above first_error, not {self.last_error} and "
                f"{self.first_error}"
            )
