# SPDX-License-Identifier: Apache-2.0
"""A card for each query that is shown: its numbers and its pictures, ready for the template."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping

import numpy as np

from gscpe.evaluation import expected_error
from gscpe.evaluation.text import degrees_text, length_text, number_text
from gscpe.geometry.pose_error import PoseDifference
from gscpe.report.query_pictures import QueryPictures
from gscpe.report.selection import Shown
from gscpe.report.settings import ReportSettings


@dataclass(frozen=True)
class Figure:
    """A picture: its ``data:`` URI, its size in pixels, and what it shows."""

    kind: str
    uri: str
    width: int
    height: int
    title: str
    caption: str


@dataclass(frozen=True)
class Card:
    """All about one query.

    Attributes:
        id: of the card, within the page.
        name: of the photo.
        kinds, why: why it is shown, see :class:`Shown`.
        problems: why it has no pose or no pictures, a sentence each.
        trusted: whether it was localized.
        photo, render: which share a place; None where they could not be made.
        small: the other pictures.
        facts: names and values.
    """

    id: str
    name: str
    kinds: tuple[str, ...]
    why: tuple[str, ...]
    problems: tuple[str, ...]
    trusted: bool
    photo: Figure | None
    render: Figure | None
    small: tuple[Figure, ...]
    facts: tuple[tuple[str, str], ...]


def card_id(index: int) -> str:
    """Of the card of a query, within the page."""
    return f"query-{index}"


def query_card(
    shown: Shown,
    detail: Mapping[str, Any],
    errors: Mapping[str, PoseDifference],
    metres_per_unit: float | None,
    drawn: QueryPictures,
    uris: Mapping[str, str],
    settings: ReportSettings,
) -> Card:
    """All about one query.

    Args:
        shown: which one, and why.
        detail: of it.
        errors: by stage, of those that are known; in metres, or in world units where
            ``metres_per_unit`` is None.
        metres_per_unit: of the map; None where it is not known.
        drawn: its pictures, whose sizes are needed, and what was counted.
        uris: of the same pictures.
        settings: what the pictures were drawn with.
    """
    figures = {}
    for kind, (title, caption) in _titles(detail, drawn, settings).items():
        if kind in uris:
            height, width = drawn.pictures[kind].shape[:2]
            figures[kind] = Figure(kind, uris[kind], width, height, title, caption)
    problems = [f"Reason: {detail['reason']}"] if detail["reason"] else []
    if drawn.problem not in (None, detail["reason"]):
        problems.append(f"There is no picture: {drawn.problem}")
    return Card(
        id=card_id(shown.index),
        name=str(detail["name"]),
        kinds=shown.kinds,
        why=shown.why,
        problems=tuple(problems),
        trusted=detail["status"] == "localized",
        photo=figures.pop("photo", None),
        render=figures.pop("render", None),
        small=tuple(figures.values()),
        facts=tuple(_facts(detail, errors, metres_per_unit).items()),
    )


def _titles(
    detail: Mapping[str, Any], drawn: QueryPictures, settings: ReportSettings
) -> dict[str, tuple[str, str]]:
    """Title and caption by kind of picture, in the order in which they are shown."""
    trusted = detail["status"] == "localized"
    where = "the final pose" if trusted else "the best pose found, which is not trusted"
    trusted_share = drawn.trusted_pixels or 0.0
    aligned = detail["aligned"] or {}
    gain, bias = aligned.get("gain"), aligned.get("bias")
    like = "render" if gain is None or bias is None else f"({gain:.2f} · render {bias:+.2f})"
    return {
        "photo": ("Photo", "The photo. No pose was found, so there is no render."),
        "render": (
            f"The map rendered at {where}",
            f"Left: the photo; right: the map rendered at {where}. Black is not in the map.",
        ),
        "matches": (
            "Matches",
            f"of photo and render, made again at this pose: {drawn.inliers} of {drawn.matches} "
            f"agree with it (green), the others do not (red); at most {settings.matches} drawn.",
        ),
        "difference": (
            "Residual",
            f"{settings.boost:g} times |photo - {like}|; dark is good, dark blue is not in the "
            "map.",
        ),
        "mask": (
            "Mask",
            f"{100 * trusted_share:.0f}% take part in the refinement; pink: hole or depth edge; "
            "orange: other views contradict the depth.",
        ),
        "depth": ("Depth", "of the render; near is bright."),
    }


def _facts(
    detail: Mapping[str, Any],
    errors: Mapping[str, PoseDifference],
    metres_per_unit: float | None,
) -> dict[str, str]:
    metric = metres_per_unit is not None

    def both(error: PoseDifference) -> str:
        return f"{length_text(error.distance, metric)}, {degrees_text(error.degrees)}"

    coarse, aligned = detail["coarse"] or {}, detail["aligned"] or {}
    facts = {f"{stage}, error": both(error) for stage, error in errors.items()}
    if detail.get("covariance") is not None:
        covariance = np.array(detail["covariance"])
        facts["standard deviation"] = both(expected_error(covariance, metres_per_unit or 1.0))
    if coarse:
        facts["inliers"] = f"{coarse['inliers']} of {coarse['matches']} matches"
    if aligned:
        facts["agreement"] = number_text(aligned["agreement"], 2)
        facts["overlap"] = number_text(aligned["overlap"], 2)
    seconds = detail["seconds"].get("total")
    if seconds is not None:
        facts["time"] = f"{seconds:.2f} s"
    if detail["reference"]:
        facts["reference"] = str(detail["reference"])
    elif detail["started_from"]:
        facts["started from"] = str(detail["started_from"])
    return facts
