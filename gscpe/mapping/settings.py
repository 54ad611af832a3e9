# SPDX-License-Identifier: Apache-2.0
"""Settings of what is checked when maps are built."""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.ranges import check_numbers, check_shares, check_whole


@dataclass(frozen=True)
class FrameCheckSettings:
    """When a splat and its reference poses fit together.

    Lengths are metres for surfaces up to 2 m away, and grow with their depth beyond that.

    Attributes:
        photos: references that are compared with small renders, at first.
        min_correlation: where no render looks like its photo to this local correlation, and
            none can be aligned with it, there is no fit.
        references: references by which the misfit is measured.
        min_measured: ... and of which so many must be found in the splat.
        warn_shift, warn_degrees, warn_scale: a misfit beyond one of these (metres, root mean
            square over the cameras; degrees; relative) is reported as a warning, ...
        max_shift, max_degrees, max_scale: ... and beyond one of these it is refused.
        sure: deviations by which a scale must differ from 1 to count.
        longest_side: photos are made smaller than this, pixels, before they are measured.
    """

    photos: int = 6
    min_correlation: float = 0.2
    references: int = 10
    min_measured: int = 3
    warn_shift: float = 0.01
    warn_degrees: float = 0.2
    warn_scale: float = 0.005
    max_shift: float = 0.03
    max_degrees: float = 0.5
    max_scale: float = 0.02
    sure: float = 4.0
    longest_side: int = 1000

    def __post_init__(self) -> None:
        check_whole(self, "photos", "references", "min_measured", least=1)
        check_whole(self, "longest_side", least=16)
        check_numbers(self, "min_correlation", least=-1, most=1)
        check_numbers(
            self,
            "warn_shift",
            "warn_degrees",
            "warn_scale",
            "max_shift",
            "max_degrees",
            "max_scale",
            "sure",
            least=0,
            infinite=True,
        )


@dataclass(frozen=True)
class MapCheckSettings:
    """When a finished map is good: its own references must come back to their own poses.

    Attributes:
        references: that are localized.
        max_shift: metres between a reference's pose and where it is localized (for surfaces up to
            2 m away; it grows with their depth beyond that), and ...
        max_degrees: ... the angle, ...
        max_sigmas: ... or so many of the result's own standard deviations, whatever is more.
        min_returned: share of the references that are localized which must come back so, ...
        min_localized: ... and share of all that must be localized at all.
    """

    references: int = 6
    max_shift: float = 0.03
    max_degrees: float = 0.5
    max_sigmas: float = 3.0
    min_returned: float = 0.65
    min_localized: float = 0.3

    def __post_init__(self) -> None:
        check_whole(self, "references", least=1)
        check_numbers(self, "max_shift", "max_degrees", "max_sigmas", least=0, infinite=True)
        check_shares(self, "min_returned", "min_localized")
