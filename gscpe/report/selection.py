# SPDX-License-Identifier: Apache-2.0
"""Which queries are shown with pictures, and why these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping, Sequence

from gscpe.evaluation.text import degrees_text, length_text
from gscpe.geometry.pose_error import PoseDifference
from gscpe.geometry.spread import thinned
from gscpe.report.settings import ReportSettings


@dataclass(frozen=True)
class Shown:
    """A query that is shown.

    Attributes:
        index: of its details.
        kinds: one or more of "refused", "worst", "slowest" and "ordinary".
        why: for people, a reason a kind.
    """

    index: int
    kinds: tuple[str, ...]
    why: tuple[str, ...]


def select_queries(
    details: Sequence[Mapping[str, Any]],
    errors: Mapping[str, PoseDifference],
    metric: bool,
    settings: ReportSettings,
) -> tuple[Shown, ...]:
    """Queries that were not localized, the worst, the slowest, and ordinary ones.

    Args:
        details: of all queries.
        errors: of the final poses by name; empty where no truth is known.
        metric: whether their distances are metres.
        settings: how many of which.
    """
    localized = [i for i, detail in enumerate(details) if detail["status"] == "localized"]
    refused = [i for i, detail in enumerate(details) if detail["status"] != "localized"]
    picked: dict[int, dict[str, str]] = {}

    def pick(index: int, kind: str, why: str) -> None:
        if index in picked or len(picked) < settings.queries:
            whys = picked.setdefault(index, {})
            whys[kind] = f"{whys[kind]}; {why}" if kind in whys else why

    for index in thinned(refused, settings.refused):
        pick(index, "refused", f"one of {len(refused)} photos without a pose")
    for index, why in _worst(details, localized, errors, metric, settings.worst):
        pick(index, "worst", why)
    timed = [i for i in range(len(details)) if "total" in details[i]["seconds"]]
    timed.sort(key=lambda i: -float(details[i]["seconds"]["total"]))
    for rank, index in enumerate(timed[: settings.slowest]):
        seconds = float(details[index]["seconds"]["total"])
        pick(index, "slowest", f"{_ordinal(rank)}slowest: {seconds:.2f} s")
    others = [i for i in localized if i not in picked]
    for index in thinned(others, max(settings.queries - len(picked), 0)):
        pick(index, "ordinary", "ordinary: spread evenly over the rest")
    return tuple(Shown(i, tuple(whys), tuple(whys.values())) for i, whys in picked.items())


def _worst(
    details: Sequence[Mapping[str, Any]],
    localized: Sequence[int],
    errors: Mapping[str, PoseDifference],
    metric: bool,
    count: int,
) -> list[tuple[int, str]]:
    """Indices and reasons: the largest distances, and the largest angle among the rest."""
    known = {i: errors[str(details[i]["name"])] for i in localized if details[i]["name"] in errors}
    if not known:
        agreement = {
            i: float(details[i]["aligned"]["agreement"])
            for i in localized
            if details[i]["aligned"] and details[i]["aligned"]["agreement"] is not None
        }
        least = sorted(agreement, key=lambda i: agreement[i])[:count]
        return [
            (i, f"{_ordinal(rank)}least agreement with the map: {agreement[i]:.2f}")
            for rank, i in enumerate(least)
        ]
    by_angle = sorted(known, key=lambda i: -known[i].degrees)[: count // 3]
    by_distance = sorted(known, key=lambda i: -known[i].distance)[: count - len(by_angle)]
    return [
        (i, f"{_ordinal(rank)}largest position error: {length_text(known[i].distance, metric)}")
        for rank, i in enumerate(by_distance)
    ] + [
        (i, f"{_ordinal(rank)}largest rotation error: {degrees_text(known[i].degrees)}")
        for rank, i in enumerate(by_angle)
    ]


def _ordinal(rank: int) -> str:
    return ("", "second ", "third ", "fourth ", "fifth ")[rank] if rank < 5 else f"{rank + 1}th "
