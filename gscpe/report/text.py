"""Numbers as people read them."""

from __future__ import annotations

import math

MISSING = "\u2013"
"""Where there is no number."""


def length_text(distance: float | None, metric: bool) -> str:
    """A distance in metres, as cm or m; or in map units where the unit is not known."""
    if distance is None or not math.isfinite(distance):
        return MISSING
    if not metric:
        return f"{distance:.3g} units"
    return f"{distance:.2f} m" if distance >= 1.0 else f"{100.0 * distance:.3g} cm"


def degrees_text(degrees: float | None) -> str:
    """An angle with its sign."""
    return MISSING if degrees is None or not math.isfinite(degrees) else f"{degrees:.3g}°"


def number_text(value: float | None, decimals: int) -> str:
    """A number with so many decimals."""
    return MISSING if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def share_text(share: float) -> str:
    """A share, in [0, 1], in percent."""
    return f"{100.0 * share:.1f} %"
