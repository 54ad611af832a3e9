# SPDX-License-Identifier: Apache-2.0
"""Settings of a report."""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.errors import SettingsError


@dataclass(frozen=True)
class ReportSettings:
    """What a report shows, and how large it may become.

    Attributes:
        queries: that are shown with pictures, at most; 0 for none.
        refused: ... of them, at most so many that were not localized,
        worst: ... so many with the largest errors (without a ground truth: the least
            agreement), and
        slowest: ... so many that took longest; the rest is spread evenly over the others.
        picture_width: pixels; pictures are never enlarged.
        quality: of the pictures, 1 to 100 (WebP); lowered where the page would become too large.
        max_bytes: intended size of the page; tables alone may exceed it.
        matches: drawn per picture, at most.
        boost: of the difference between photo and render.
        marks: cameras of a kind that are drawn in the view from above, at most.
        date: shown on the page, as text; empty for none.
    """

    queries: int = 16
    refused: int = 4
    worst: int = 5
    slowest: int = 2
    picture_width: int = 480
    quality: int = 80
    max_bytes: int = 5_000_000
    matches: int = 150
    boost: float = 4.0
    marks: int = 400
    date: str = ""

    def __post_init__(self) -> None:
        if min(self.queries, self.refused, self.worst, self.slowest, self.matches) < 0:
            raise SettingsError("the numbers of queries and matches in a report cannot be negative")
        if self.picture_width < 16 or not 1 <= self.quality <= 100 or self.boost <= 0:
            raise SettingsError(
                "pictures need a width of at least 16 pixels, a quality of 1 to 100 and a "
                f"positive boost, not {self.picture_width}, {self.quality} and {self.boost}"
            )
        if self.marks < 1 or self.max_bytes < 1:
            raise SettingsError(
                "a report needs at least one mark of each kind, and a positive size"
            )
