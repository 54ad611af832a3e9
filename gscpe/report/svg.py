# SPDX-License-Identifier: Apache-2.0
"""What drawings are made of: SVG elements, axes and round numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from gscpe.arrays import Float64Array

_STEPS = (1.0, 2.0, 5.0)


def element(name: str, /, *content: str, **attributes: str | float) -> Markup:
    """``<name ...>content</name>``; text that is not markup already is escaped.

    Attributes are named as in SVG, with ``_`` for ``-`` and at the end of Python's words
    (``class_``). Numbers are written with at most two decimals.
    """
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(_text(value))}"'
        for key, value in attributes.items()
    )
    return Markup(f"<{name}{written}>{join(*content)}</{name}>")


def join(*pieces: str) -> Markup:
    """Pieces one after the other; text among them is escaped."""
    return Markup("").join(pieces)


def _text(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.2f}".rstrip("0").rstrip(".")


@dataclass(frozen=True)
class LogAxis:
    """A logarithmic axis from ``low`` to ``high`` over ``begin`` to ``end`` pixels."""

    low: float
    high: float
    begin: float
    end: float

    def at(self, values: Float64Array) -> Float64Array:
        """Pixels of values, (N,); those beyond the axis are put at its ends."""
        inside = np.clip(values, self.low, self.high)
        share = np.log(inside / self.low) / np.log(self.high / self.low)
        return np.asarray(self.begin + share * (self.end - self.begin))

    def ticks(self) -> list[float]:
        """1, 2, 5, 10, ... within the axis; powers of ten where that would be too many."""
        exponents = range(
            int(np.floor(np.log10(self.low))) - 1, int(np.ceil(np.log10(self.high))) + 1
        )
        steps = _STEPS if self.high / self.low <= 2000 else (1.0,)
        ticks = (step * 10.0**exponent for exponent in exponents for step in steps)
        slack = 1.0 + 1e-9
        return [tick for tick in ticks if self.low <= tick * slack and tick <= self.high * slack]


def log_axis(values: Float64Array, begin: float, end: float) -> LogAxis:
    """An axis that shows the middle 96% of the values, (N,) positive, at least a decade."""
    low, high = np.quantile(values, [0.02, 0.98])
    low, high = round_down(float(low)), round_up(float(high))
    if high < 10.0 * low:
        low = round_down(high / 10.0)
    return LogAxis(low, high, begin, end)


def round_down(value: float) -> float:
    """The largest of 1, 2, 5, 10, ... (times any power of ten) that is not above the value."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in _STEPS if step * power <= value * (1 + 1e-9))


def round_up(value: float) -> float:
    """The smallest of 1, 2, 5, 10, ... (times any power of ten) that is not below the value."""
    power = 10.0 ** math.floor(math.log10(value))
    candidates = [step * power for step in (*_STEPS, 10.0)]
    return min(candidate for candidate in candidates if candidate >= value * (1 - 1e-9))
