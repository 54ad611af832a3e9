# SPDX-License-Identifier: Apache-2.0
"""Cumulative error curves, drawn as SVG."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from gscpe.arrays import Float64Array
from gscpe.geometry.spread import evenly_spread
from gscpe.report.svg import LogAxis, element, log_axis

_WIDTH, _HEIGHT = 480.0, 300.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 60.0, 444.0, 12.0, 250.0  # room for half a label on the right
_MOST_POINTS = 400
_SMALLEST = 1e-9  # an error of zero has no place on a logarithmic axis


@dataclass(frozen=True)
class Curves:
    """A drawing of curves.

    Attributes:
        drawing: an ``svg`` element; empty where there is nothing to draw.
        legend: a text a curve, by stage.
        title: what the errors are of.
    """

    drawing: Markup
    legend: Mapping[str, str]
    title: str


def cumulative_curves(
    title: str, unit: str, errors: Mapping[str, Sequence[float]], queries: int
) -> Curves:
    """Share of all queries with an error of at most x, a curve a stage.

    Args:
        title: what the errors are of, for example "position error".
        unit: that the errors are given in.
        errors: of the localized queries, by stage, which is the CSS class of its curve too.
        queries: what 100% is: the queries of the truth, localized or not.
    """
    drawn = {
        stage: np.sort(np.maximum(values, _SMALLEST)) for stage, values in errors.items() if values
    }
    if not drawn:
        return Curves(Markup(""), {}, title)
    axis = log_axis(np.concatenate(list(drawn.values())), _LEFT, _RIGHT)
    after = unit if unit == "°" else f" {unit}"
    medians = {
        stage: f"{stage}: median {float(np.median(values)):.3g}{after}"
        for stage, values in drawn.items()
    }
    curves = [_curve(stage, values, queries, axis) for stage, values in drawn.items()]
    drawing = element(
        "svg",
        _grid(axis, f"{title}, {unit}"),
        *curves,
        class_="plot",
        viewBox=f"0 0 {_WIDTH:g} {_HEIGHT:g}",
        role="img",
        aria_label=f"Cumulative {title}. {'; '.join(medians.values())}.",
    )
    return Curves(drawing, medians, title)


def _curve(stage: str, errors: Float64Array, queries: int, axis: LogAxis) -> Markup:
    """Steps up at every error; level after the last, where what was not localized is missing."""
    shares = np.arange(1, len(errors) + 1) / queries
    if len(errors) > _MOST_POINTS:
        kept = evenly_spread(len(errors), _MOST_POINTS)
        errors, shares = errors[kept], shares[kept]
    within = errors <= axis.high
    errors, shares = errors[within], shares[within]
    steps = "".join(
        f"H{x:.1f}V{y:.1f}" for x, y in zip(axis.at(errors), _height(shares), strict=True)
    )
    path = f"M{_LEFT:g} {_BOTTOM:g}{steps}H{_RIGHT:g}"
    return element("path", d=path, class_=f"curve {stage}")


def _height(shares: Float64Array) -> Float64Array:
    return np.asarray(_BOTTOM - shares * (_BOTTOM - _TOP))


def _grid(axis: LogAxis, label: str) -> Markup:
    pieces = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = float(_height(np.array(share)))
        pieces.append(element("path", d=f"M{_LEFT:g} {y:g}H{_RIGHT:g}", class_="grid"))
        text = f"{100 * share:.0f} %"
        pieces.append(element("text", text, x=_LEFT - 6, y=y + 4, text_anchor="end"))
    ticks = axis.ticks()
    for tick, x in zip(ticks, axis.at(np.array(ticks)), strict=True):
        pieces.append(element("path", d=f"M{x:.1f} {_TOP:g}V{_BOTTOM:g}", class_="grid"))
        text = f"{tick:g}"
        pieces.append(element("text", text, x=float(x), y=_BOTTOM + 18, text_anchor="middle"))
    middle = (_LEFT + _RIGHT) / 2
    pieces.append(element("text", label, x=middle, y=_HEIGHT - 8, text_anchor="middle"))
    return element("g", *pieces)
