"""The report of a run: one HTML file that needs nothing else, and no network."""

from __future__ import annotations

import base64
import hashlib
import sys
from importlib import resources
from pathlib import Path
from typing import Sequence

import numpy as np
from tqdm import tqdm

from gscpe.errors import OutputError
from gscpe.evaluation import SceneRun
from gscpe.localization import Localizer
from gscpe.matching import Matcher
from gscpe.report.cards import card_id, query_card
from gscpe.report.curves import cumulative_curves
from gscpe.report.encode import data_uris
from gscpe.report.markup import Markup, element, join
from gscpe.report.query_errors import Errors, errors_by_stage, true_poses
from gscpe.report.query_pictures import QueryPictures, draw_query
from gscpe.report.selection import Shown, select_queries
from gscpe.report.settings import ReportSettings
from gscpe.report.tables import accuracy_table, query_table, runtime_table
from gscpe.report.text import degrees_text, length_text, share_text
from gscpe.report.top_view import top_view

_SECTIONS = {
    "accuracy": "Accuracy",
    "above": "From above",
    "shown": "Queries in pictures",
    "runtime": "Runtime",
    "all": "All queries",
}


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
    errors = errors_by_stage(run)
    shown = select_queries(run.details, errors["final"], metric, settings)
    drawn = [
        draw_query(run.details[item.index], localizer, matcher, Path(image_folder), settings)
        for item in tqdm(shown, desc="drawing queries", disable=not (progress and sys.stderr))
    ]
    page = _page(run, errors, localizer, settings, shown, drawn)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(page.encode("utf-8", "replace"))
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from error


def _page(
    run: SceneRun,
    errors: Errors,
    localizer: Localizer,
    settings: ReportSettings,
    shown: Sequence[Shown],
    drawn: Sequence[QueryPictures],
) -> str:
    metric = run.metres_per_unit is not None
    links = {str(run.details[i.index]["name"]): f"#{card_id(i.index)}" for i in shown}
    sections = {
        "accuracy": join(accuracy_table(run), _medians_note(run), _curves(run, errors)),
        "above": top_view(run, errors, localizer.map, settings, links),
        "runtime": runtime_table(run.details),
        "all": join(_filter(), query_table(run, errors, shown, links)),
    }
    style, script = (
        resources.files("gscpe.report").joinpath(name).read_text(encoding="utf-8")
        for name in ("page.css", "page.js")
    )
    header = _header(run, settings)
    written = sum(len(text) for text in (*sections.values(), style, script, header))
    flat = [picture for item in drawn for picture in item.pictures.values()]
    uris = iter(data_uris(flat, settings.quality, settings.max_bytes - written))
    cards = []
    for item, pictures in zip(shown, drawn, strict=True):
        detail = run.details[item.index]
        name = str(detail["name"])
        of_query = {stage: known[name] for stage, known in errors.items() if name in known}
        named = {kind: next(uris) for kind in pictures.pictures}
        cards.append(query_card(item, detail, of_query, metric, pictures, named, settings))
    hint = (
        f"{len(cards)} of {len(run.details)}, each with the reason why it is shown. Drag the line "
        "between photo and render, or use the arrow keys; click a small picture to enlarge it."
    )
    sections["shown"] = join(
        element("p", hint if cards else "None is shown.", class_="note"), *cards
    )
    body = element(
        "body",
        header,
        element(
            "main",
            *(
                element("section", element("h2", title), sections[key], id=key)
                for key, title in _SECTIONS.items()
            ),
        ),
        _footer(metric),
        element("dialog", element("img", alt=""), element("p"), id="enlarged"),
        element("script", Markup(script)),
    )
    title = f"{run.dataset} {run.scene}: localization report"
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=_policy(style, script)),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", title),
        element("style", Markup(style)),
    )
    return f"<!DOCTYPE html>\n{element('html', head, body, lang='en')}\n"


def _policy(style: str, script: str) -> str:
    """Nothing is loaded, and nothing runs but the two that the page was written with."""
    style_hash, script_hash = (
        base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        for text in (style, script)
    )
    return (
        f"default-src 'none'; img-src data:; style-src 'sha256-{style_hash}'; "
        f"script-src 'sha256-{script_hash}'; base-uri 'none'; form-action 'none'"
    )


def _header(run: SceneRun, settings: ReportSettings) -> Markup:
    setup = dict(run.setup) | ({"date": settings.date} if settings.date else {})
    return element(
        "header",
        element("p", f"{run.dataset} · localization report", class_="eyebrow"),
        element("h1", run.scene),
        element("ul", *_tiles(run), class_="tiles"),
        element(
            "dl",
            *(element("div", element("dt", k), element("dd", v)) for k, v in setup.items()),
            class_="facts setup",
        ),
        element(
            "nav",
            *(element("a", title, href=f"#{key}") for key, title in _SECTIONS.items()),
            aria_label="Sections",
        ),
        class_="page",
    )


def _tiles(run: SceneRun) -> list[Markup]:
    metric = run.metres_per_unit is not None
    localized = sum(detail["status"] == "localized" for detail in run.details)
    tiles = [(f"{localized} / {len(run.details)}", "photos localized")]
    names = {str(detail["name"]) for detail in run.details}
    if names & true_poses(run).keys():
        result = run.evaluate("final")
        tiles.append((length_text(result.median_distance, metric), "median position error*"))
        tiles.append((degrees_text(result.median_degrees), "median rotation error*"))
        if metric:
            tiles.append((share_text(result.shares[1]), "within 5 cm and 5°"))
    totals = [float(d["seconds"]["total"]) for d in run.details if "total" in d["seconds"]]
    if totals:
        tiles.append((f"{np.median(totals):.2f} s", "median time a photo"))
    return [
        element("li", element("strong", number), element("span", what)) for number, what in tiles
    ]


def _medians_note(run: SceneRun) -> Markup:
    if not run.truths:
        return Markup("")
    text = "* Medians are over the photos that have a pose; shares are of all photos."
    return element("p", text, class_="note")


def _curves(run: SceneRun, errors: Errors) -> Markup:
    """Of the first ground truth; nothing where there is none."""
    names = {str(detail["name"]) for detail in run.details}
    queries = len(names & true_poses(run).keys())
    if not queries:
        return Markup("")
    unit, factor = ("cm", 100.0) if run.metres_per_unit is not None else ("map units", 1.0)
    distances, degrees = {}, {}
    for stage in ("coarse", "final"):
        distances[stage] = [factor * error.distance for error in errors[stage].values()]
        degrees[stage] = [error.degrees for error in errors[stage].values()]
    truth = next(iter(run.truths))
    caption = (
        f"Share of the {queries} queries that {truth} knows whose error is at most x; those that "
        "were not localized count as beyond every x. The axes are logarithmic and show the "
        "middle 96 % of the errors."
    )
    return element(
        "figure",
        element(
            "div",
            cumulative_curves("position error", unit, distances, queries),
            cumulative_curves("rotation error", "°", degrees, queries),
            class_="pair",
        ),
        element("figcaption", caption),
        class_="wide",
    )


def _filter() -> Markup:
    box = element("input", type="search", id="filter", placeholder="name, status, reason …")
    return element("p", element("label", "Show ", box), class_="filter")


def _footer(metric: bool) -> Markup:
    unit = "" if metric else " The map's unit is not known: distances are in map units."
    return element(
        "footer",
        element(
            "p",
            "Position error: distance between the estimated and the true camera centre. Rotation "
            "error: angle between the estimated and the true orientation. Coarse: from matches "
            "alone. Refined: from aligning the photo to renders. Final: both, weighted by their "
            f"covariances.{unit} Written by gscpe; this page loads nothing.",
        ),
    )
