"""The report's tables."""

from __future__ import annotations

from typing import Any, Iterable, Mapping, Sequence

import numpy as np

from gscpe.evaluation import THRESHOLDS, SceneRun
from gscpe.report.markup import Markup, element, join
from gscpe.report.query_errors import STAGES, Errors
from gscpe.report.selection import Shown
from gscpe.report.text import MISSING, length_text, number_text, share_text

_BAR = 120.0
_WORDS = {"ground truth", "stage", "photo", "status, reason", "reference", "share of the time"}
"""Headings of columns that do not hold numbers."""

_MARKED = {"worst", "slowest"}
"""Kinds of queries that are marked in the table; the status says the others."""


def accuracy_table(run: SceneRun) -> Markup:
    """Median errors and shares of each stage, against each ground truth."""
    metric = run.metres_per_unit is not None
    head = ["ground truth", "stage", "localized", "median position*", "median rotation*"]
    if metric:
        head += [f"≤ {100 * metres:g} cm, {degrees:g}°" for metres, degrees in THRESHOLDS]
    names = {str(detail["name"]) for detail in run.details}
    rows = []
    for truth, poses in run.truths.items():
        if not names & poses.keys():
            unknown = element("td", "knows none of these photos", colspan=len(head) - 1)
            rows.append(element("tr", element("th", truth, scope="row"), unknown))
            continue
        for stage in STAGES:
            result = run.evaluate(stage, truth)
            cells = [
                f"{result.localized} of {result.queries}",
                length_text(result.median_distance, metric),
                number_text(result.median_degrees, 3) + "°" * bool(result.localized),
                *(share_text(share) for share in (result.shares if metric else ())),
            ]
            first = element("th", truth if stage == STAGES[0] else "", scope="row")
            row = [first, element("td", _stage_key(stage)), *_cells(cells)]
            rows.append(element("tr", *row, class_="total" if stage == "final" else None))
    if not rows:
        return element("p", "No ground truth is known: there are no errors.", class_="note")
    return _table("Accuracy by stage and ground truth", head, rows)


def runtime_table(details: Sequence[Mapping[str, Any]]) -> Markup:
    """Wall time by stage, over the queries that reached it."""
    stages: dict[str, list[float]] = {}
    for detail in details:
        for stage, seconds in detail["seconds"].items():
            stages.setdefault(str(stage), []).append(float(seconds))
    if not stages:
        return element("p", "No times were taken.", class_="note")
    ordered = [stage for stage in stages if stage != "total"] + ["total"] * ("total" in stages)
    longest = max(sum(seconds) for seconds in stages.values()) or 1.0
    head = ["stage", "queries", "median", "90 % within", "longest", "share of the time"]
    rows = []
    for stage in ordered:
        seconds = np.array(stages[stage])
        share = float(seconds.sum()) / longest
        cells = [f"{len(seconds)}"]
        cells += [f"{value:.3f} s" for value in np.quantile(seconds, [0.5, 0.9, 1.0])]
        bar = element(
            "svg",
            element("rect", width=_BAR, height=10, class_="track"),
            element("rect", width=max(1.0, _BAR * share), height=10, class_="fill"),
            class_="share", viewBox=f"0 0 {_BAR:g} 10", aria_hidden="true",
        )  # fmt: skip
        row = [element("th", stage, scope="row"), *_cells(cells)]
        row.append(element("td", bar, " ", share_text(share)))
        rows.append(element("tr", *row, class_="total" if stage == "total" else None))
    return _table("Wall time by stage", head, rows)


def query_table(
    run: SceneRun, errors: Errors, shown: Sequence[Shown], links: Mapping[str, str]
) -> Markup:
    """Every query; the page's script sorts and filters it."""
    unit, factor = ("cm", 100.0) if run.metres_per_unit is not None else ("units", 1.0)
    marks = {item.index: [kind for kind in item.kinds if kind in _MARKED] for item in shown}
    numbers = [
        f"coarse position, {unit}", f"final position, {unit}", "coarse rotation, °",
        "final rotation, °", "inliers", "agreement", "seconds",
    ]  # fmt: skip
    if not run.truths:
        numbers = numbers[4:]
    rows = []
    for index, detail in enumerate(run.details):
        name = str(detail["name"])
        coarse, aligned = detail["coarse"] or {}, detail["aligned"] or {}
        first: str = element("a", name, href=links[name]) if name in links else name
        for kind in marks.get(index, ()):
            first = join(first, " ", tag(kind))
        status = str(detail["status"])
        texts = [element("th", first, scope="row"), _status(status, detail["reason"])]
        values: list[str] = []
        if run.truths:
            for attribute, scale, decimals in (("distance", factor, 2), ("degrees", 1.0, 3)):
                for stage in ("coarse", "final"):
                    error = errors[stage].get(name)
                    value = None if error is None else scale * getattr(error, attribute)
                    values.append(number_text(value, decimals))
        values += [
            f"{coarse['inliers']}" if "inliers" in coarse else MISSING,
            number_text(aligned.get("agreement"), 2),
            number_text(detail["seconds"].get("total"), 2),
        ]
        reference = element("td", str(detail["reference"] or MISSING))
        rows.append(element("tr", *texts, *_cells(values), reference))
    head = ["photo", "status, reason", *numbers, "reference"]
    return _table("All queries", head, rows, sortable=True)


def _status(status: str, reason: str | None) -> Markup:
    """Only what was refused has a reason; a column of its own would be empty in good runs."""
    if reason is None:
        return element("td", status)
    return element("td", f"{status}: ", element("span", reason), class_="refused")


def tag(kind: str) -> Markup:
    """A coloured word that marks a query."""
    return element("span", "not localized" if kind == "refused" else kind, class_=f"tag {kind}")


def _stage_key(stage: str) -> Markup:
    return join(element("span", class_=f"key {stage}"), stage)


def _cells(texts: Iterable[str]) -> list[Markup]:
    return [element("td", text, class_="number") for text in texts]


def _table(
    caption: str, head: Sequence[str], rows: Sequence[Markup], sortable: bool = False
) -> Markup:
    """Numbers are wide; the table scrolls within itself on narrow screens."""
    titles = [
        element(
            "th",
            element("button", text, type="button") if sortable else text,
            scope="col",
            class_=None if text in _WORDS else "number",
        )
        for text in head
    ]
    table = element(
        "table",
        element("caption", caption),
        element("thead", element("tr", *titles)),
        element("tbody", *rows),
        class_="sortable" if sortable else None,
    )
    return element("div", table, class_="scroller", tabindex=0, role="region", aria_label=caption)
