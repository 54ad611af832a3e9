# SPDX-License-Identifier: Apache-2.0
"""The report of a run: one HTML file that needs nothing else, and no network."""

from __future__ import annotations

import sys
from importlib import resources
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np
from tqdm import tqdm

from gscpe.evaluation import SceneRun, Stage
from gscpe.evaluation.query_table import query_table
from gscpe.evaluation.runtime_table import stage_times_table
from gscpe.evaluation.tables import accuracy_tables
from gscpe.evaluation.text import degrees_text, length_text, share_text
from gscpe.geometry.pose_error import PoseDifference
from gscpe.localization import Localizer
from gscpe.matching import Matcher
from gscpe.output_file import write_file
from gscpe.report.cards import card_id, query_card
from gscpe.report.curves import Curves, cumulative_curves
from gscpe.report.encode import data_uris
from gscpe.report.one_file import filled_page
from gscpe.report.query_pictures import draw_query
from gscpe.report.selection import Shown, select_queries
from gscpe.report.settings import ReportSettings
from gscpe.report.top_view import top_view
from gscpe.scene import Map

_STAGES: tuple[Stage, ...] = ("coarse", "aligned", "final")
_MARKED = {"worst", "slowest"}
"""Kinds of queries that are marked in the table; the status says the others."""


def write_report(
    path: str | Path,
    run: SceneRun,
    localizer: Localizer,
    image_folder: str | Path,
    settings: ReportSettings | None = None,
    matcher: Matcher | None = None,
    progress: bool = False,
) -> None:
    """Writes a run as one HTML page with its tables, curves and pictures.

    Args:
        path: of the page.
        run: what was localized.
        localizer: that did it, still open: the pictures are rendered and its map is drawn.
        image_folder: that the queries' names are relative to.
        settings: see :class:`ReportSettings`.
        matcher: the localizer's, to draw matches; None: none are drawn.
        progress: show a bar.

    Raises:
        OutputError: the page cannot be written.
        RenderError, ModelError: rendering or matching failed.
    """
    path, settings = Path(path), settings or ReportSettings()
    metric = run.metres_per_unit is not None
    errors = {stage: run.errors(stage) for stage in _STAGES}
    shown = select_queries(run.details, errors["final"], metric, settings)
    drawn = [
        draw_query(run.details[item.index], localizer, matcher, Path(image_folder), settings)
        for item in tqdm(shown, desc="drawing queries", disable=not (progress and sys.stderr))
    ]
    names = [str(run.details[item.index]["name"]) for item in shown]
    by_name = dict(zip(names, shown, strict=True))
    rest = _without_cards(run, errors, localizer.map, by_name, settings)

    def page(uris: Sequence[str]) -> str:
        """With these URIs of all pictures in turn."""
        following = iter(uris)
        cards = [
            query_card(
                item,
                run.details[item.index],
                {stage: known[name] for stage, known in errors.items() if name in known},
                run.metres_per_unit,
                pictures,
                {kind: next(following) for kind in pictures.pictures},
                settings,
            )
            for name, item, pictures in zip(names, shown, drawn, strict=True)
        ]
        return _fill_template({**rest, "cards": cards})

    flat = [picture for item in drawn for picture in item.pictures.values()]
    without_pictures = len(page([""] * len(flat)))
    text = page(data_uris(flat, settings.quality, settings.max_bytes - without_pictures))
    write_file(path, text.encode("utf-8", "replace"))


def _without_cards(
    run: SceneRun,
    errors: Mapping[Stage, Mapping[str, PoseDifference]],
    map_: Map,
    shown: Mapping[str, Shown],
    settings: ReportSettings,
) -> dict[str, Any]:
    """What the template is filled with, but for the cards of the queries that are shown."""
    links = {name: f"#{card_id(item.index)}" for name, item in shown.items()}
    return {
        "run": run,
        "setup": dict(run.setup) | ({"date": settings.date} if settings.date else {}),
        "tiles": _tiles(run),
        "accuracy": accuracy_tables([run]),
        "curves": _curves(run, errors),
        "known": _known_queries(run),
        "truth": next(iter(run.truths), ""),
        "above": top_view(run, map_, settings, links),
        "times": stage_times_table(run.details),
        "queries": query_table(run),
        "links": links,
        "marks": {
            name: [kind for kind in item.kinds if kind in _MARKED] for name, item in shown.items()
        },
    }


def _fill_template(values: Mapping[str, Any]) -> str:
    template, style, script = (
        resources.files("gscpe.report").joinpath(name).read_text(encoding="utf-8")
        for name in ("page.html.jinja", "page.css", "page.js")
    )
    return filled_page(template, values, style, script)


def _known_queries(run: SceneRun) -> int:
    """How many queries the first ground truth knows."""
    return len({str(detail["name"]) for detail in run.details} & run.truth.keys())


def _tiles(run: SceneRun) -> list[tuple[str, str]]:
    """The numbers at the top, and what they are."""
    metric = run.metres_per_unit is not None
    localized = sum(detail["status"] == "localized" for detail in run.details)
    tiles = [(f"{localized} / {len(run.details)}", "photos localized")]
    if _known_queries(run):
        result = run.evaluate("final")
        tiles.append((length_text(result.median_distance, metric), "their median position error"))
        tiles.append((degrees_text(result.median_degrees), "their median rotation error"))
        if metric:
            tiles.append((share_text(result.shares[1]), "of all within 5 cm and 5°"))
    totals = [float(d["seconds"]["total"]) for d in run.details if "total" in d["seconds"]]
    if totals:
        tiles.append((f"{np.median(totals):.2f} s", "median time per photo"))
    return tiles


def _curves(
    run: SceneRun, errors: Mapping[Stage, Mapping[str, PoseDifference]]
) -> tuple[Curves, ...]:
    """Of the first ground truth; none where it knows no query."""
    queries = _known_queries(run)
    if not queries:
        return ()
    unit, factor = ("cm", 100.0) if run.metres_per_unit is not None else ("world units", 1.0)
    distances: dict[str, list[float]] = {}
    degrees: dict[str, list[float]] = {}
    for stage in _STAGES:
        distances[stage] = [factor * error.distance for error in errors[stage].values()]
        degrees[stage] = [error.degrees for error in errors[stage].values()]
    return (
        cumulative_curves("position error", unit, distances, queries),
        cumulative_curves("rotation error", "°", degrees, queries),
    )
