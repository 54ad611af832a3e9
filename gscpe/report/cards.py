"""A card for each query that is shown: its numbers and its pictures."""

from __future__ import annotations

from typing import Any, Mapping, Sequence

from gscpe.geometry.pose_error import PoseDifference
from gscpe.report.markup import Markup, element, join
from gscpe.report.query_pictures import QueryPictures
from gscpe.report.selection import Shown
from gscpe.report.settings import ReportSettings
from gscpe.report.tables import tag
from gscpe.report.text import degrees_text, length_text, number_text


def card_id(index: int) -> str:
    """Of the card of a query, within the page."""
    return f"query-{index}"


def query_card(
    shown: Shown,
    detail: Mapping[str, Any],
    errors: Mapping[str, PoseDifference],
    metric: bool,
    drawn: QueryPictures,
    uris: Mapping[str, str],
    settings: ReportSettings,
) -> Markup:
    """All about one query.

    Args:
        shown: which one, and why.
        detail: of it.
        errors: by stage, of those that are known.
        metric: whether their distances are metres.
        drawn: its pictures, whose sizes are needed, and what was counted.
        uris: of the same pictures.
        settings: what the pictures were drawn with.
    """
    name, trusted = str(detail["name"]), detail["status"] == "localized"
    header = element(
        "header",
        element("h3", name),
        element(
            "p", *(join(tag(kind), " ") for kind in shown.kinds), "; ".join(shown.why), class_="why"
        ),
    )
    body: list[Markup] = []
    if detail["reason"]:
        body.append(element("p", element("strong", "Reason: "), detail["reason"], class_="reason"))
    if drawn.problem not in (None, detail["reason"]):
        body.append(element("p", f"There is no picture: {drawn.problem}", class_="reason"))
    main = _main_figure(name, drawn, uris, trusted)
    facts = _facts(detail, errors, metric, drawn)
    small = [
        _small_figure(kind, name, title, caption, drawn, uris)
        for kind, title, caption in _kinds(drawn, detail, settings)
        if kind in uris
    ]
    body.append(
        element(
            "div",
            element("div", *main, facts, class_="main"),
            element("div", *small, class_="small"),
            class_="columns",
        )
    )
    return element(
        "article",
        header,
        *body,
        class_="card",
        id=card_id(shown.index),
    )


def _main_figure(
    name: str, drawn: QueryPictures, uris: Mapping[str, str], trusted: bool
) -> Sequence[Markup]:
    """The photo, with the render behind a slider where there is one."""
    if "photo" not in uris:
        return ()
    photo = _image("photo", f"Photo {name}", drawn, uris)
    if "render" not in uris:
        caption = element("figcaption", "The photo. No pose was found, so there is no render.")
        return (element("figure", photo, caption),)
    where = "the final pose" if trusted else "the best pose found, which is not trusted"
    render = _image("render", f"The map rendered at {where}", drawn, uris, class_="over")
    slider = element(
        "input",
        type="range", min=0, max=100, value=50, step=1,
        aria_label=f"How much of photo {name} is shown; the rest is the render",
    )  # fmt: skip
    labels = (
        element("span", "photo", class_="label left", aria_hidden="true"),
        element(
            "span",
            "render" if trusted else "render, not trusted",
            class_="label right",
            aria_hidden="true",
        ),
    )
    caption = element("figcaption", f"Left: the photo; right: the map rendered at {where}.")
    return (
        element(
            "figure", element("div", photo, render, *labels, slider, class_="compare"), caption
        ),
    )


def _small_figure(
    kind: str,
    name: str,
    title: str,
    caption: str,
    drawn: QueryPictures,
    uris: Mapping[str, str],
) -> Markup:
    image = _image(kind, f"{title} of {name}", drawn, uris)
    enlarge = element("button", image, type="button", class_="enlarge", title="enlarge")
    text = element("figcaption", element("strong", title), " ", caption)
    return element("figure", enlarge, text, class_=kind)


def _kinds(
    drawn: QueryPictures, detail: Mapping[str, Any], settings: ReportSettings
) -> list[tuple[str, str, str]]:
    """Kind, title and caption of the small pictures."""
    trusted_share = drawn.trusted_pixels or 0.0
    aligned = detail["aligned"] or {}
    gain, bias = aligned.get("gain"), aligned.get("bias")
    like = "render" if gain is None or bias is None else f"({gain:.2f} · render {bias:+.2f})"
    return [
        (
            "matches",
            "Matches",
            f"of photo and render, made again at this pose: {drawn.inliers} of {drawn.matches} "
            f"agree with it (green), the others do not (red); at most {settings.matches} drawn.",
        ),
        (
            "difference",
            "Residual",
            f"{settings.boost:g} times |photo - {like}|; dark is good.",
        ),
        (
            "mask",
            "Mask",
            f"{100 * trusted_share:.0f} % take part in the refinement; pink: hole or depth edge; "
            "orange: other views contradict the depth.",
        ),
        ("depth", "Depth", "of the render; near is bright."),
    ]


def _facts(
    detail: Mapping[str, Any],
    errors: Mapping[str, PoseDifference],
    metric: bool,
    drawn: QueryPictures,
) -> Markup:
    coarse, aligned = detail["coarse"] or {}, detail["aligned"] or {}
    facts = [
        (
            f"{stage}, error",
            f"{length_text(error.distance, metric)}, {degrees_text(error.degrees)}",
        )
        for stage, error in errors.items()
    ]
    if coarse:
        facts.append(("inliers", f"{coarse['inliers']} of {coarse['matches']} matches"))
    if aligned:
        facts.append(("agreement", number_text(aligned["agreement"], 2)))
        facts.append(("overlap", number_text(aligned["overlap"], 2)))
    seconds = detail["seconds"].get("total")
    if seconds is not None:
        facts.append(("time", f"{seconds:.2f} s"))
    if detail["reference"]:
        facts.append(("reference", str(detail["reference"])))
    elif detail["started_from"]:
        facts.append(("started from", str(detail["started_from"])))
    return element(
        "dl",
        *(element("div", element("dt", what), element("dd", value)) for what, value in facts),
        class_="facts",
    )


def _image(
    kind: str,
    alt: str,
    drawn: QueryPictures,
    uris: Mapping[str, str],
    class_: str | None = None,
) -> Markup:
    height, width = drawn.pictures[kind].shape[:2]
    return element("img", src=uris[kind], alt=alt, width=width, height=height, class_=class_)
