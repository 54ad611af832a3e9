# SPDX-License-Identifier: Apache-2.0
"""Numbers as people read them."""

from __future__ import annotations

import math

NOTHING = "\N{EN DASH}"
"""What stands where there is no number."""


def length_text(distance: float | None, metric: bool) -> str:
    """A distance in metres, as cm or m; or in world units where the unit is not known."""
    if distance is None or not math.isfinite(distance):
        return NOTHING
    if not metric:
        return f"{significant_text(distance)} units"
    return f"{distance:.2f} m" if distance >= 1.0 else f"{100.0 * distance:.3g} cm"


def degrees_text(degrees: float | None) -> str:
    """An angle with its sign."""
    return NOTHING if degrees is None or not math.isfinite(degrees) else f"{degrees:.3g}°"


def number_text(value: float | None, decimals: int) -> str:
    """A number with so many decimals."""
    return NOTHING if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def significant_text(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, all digits before its point among them; for
    what may be of any size, as lengths in an unknown unit."""
    if value is None or not math.isfinite(value):
        return NOTHING
    large = abs(value) >= 10.0**digits - 0.5
    return f"{value:.0f}" if large else f"{value:.{digits}g}"


def share_text(share: float) -> str:
    """A share, in [0, 1], in percent."""
    return NOTHING if math.isnan(share) else f"{100.0 * share:.1f}%"
