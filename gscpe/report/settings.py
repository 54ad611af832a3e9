# SPDX-License-Identifier: Apache-2.0
"""Settings of a report."""

from __future__ import annotations

from dataclasses import dataclass

from gscpe.ranges import check_kinds, check_numbers, check_whole


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
        check_whole(self, "queries", "refused", "worst", "slowest", "matches", least=0)
        check_whole(self, "picture_width", least=16)
        check_whole(self, "quality", least=1, most=100)
        check_whole(self, "marks", "max_bytes", least=1)
        check_numbers(self, "boost", above=0)
        check_kinds(self, date=str)
