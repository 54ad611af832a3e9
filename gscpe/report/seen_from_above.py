# SPDX-License-Identifier: Apache-2.0
"""Drawings of a map from above: the part that they share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np
from markupsafe import Markup

from gscpe.arrays import Float64Array
from gscpe.report.encode import data_uri
from gscpe.report.ground import GroundPlane, density_picture
from gscpe.report.svg import element, round_down
from gscpe.scene import Map

WIDTH = 960.0
"""Of a drawing, pixels."""

_MARGIN = 0.08
_FARTHEST = 0.4
"""Times the extent of the cameras that the Gaussians may add on each side, ..."""

_LEAST = 0.2
"""... or times the extent of the Gaussians: cameras on one spot need something around them."""

_TICK = 13.0
_QUALITY = 80


@dataclass(frozen=True, eq=False)
class Frame:
    """From the ground plane, map units, to the picture, pixels, y downwards.

    Attributes:
        low, high: (2,), corners of what is shown, in the plane.
    """

    low: Float64Array
    high: Float64Array

    @property
    def scale(self) -> float:
        """Pixels in a map unit."""
        return float(WIDTH / (self.high[0] - self.low[0]))

    @property
    def height(self) -> float:
        """Of the picture, which is :data:`WIDTH` wide; pixels."""
        return float(self.scale * (self.high[1] - self.low[1]))

    def at(self, flat: Float64Array) -> Float64Array:
        """Pixels, (N, 2), of points in the plane, (N, 2)."""
        return np.asarray((flat - (self.low[0], self.high[1])) * (self.scale, -self.scale))


def density_layer(map_: Map, plane: GroundPlane, frame: Frame, ceiling: float) -> Markup:
    """The Gaussians' centres below the ceiling, map units."""
    picture = density_picture(map_.scene, plane, frame.low, frame.high, ceiling)
    return element(
        "image",
        href=data_uri(picture, _QUALITY),
        x=0, y=0, width=WIDTH, height=frame.height,
        preserveAspectRatio="none",
        class_="density",
    )  # fmt: skip


def drawing_of(layers: Sequence[Markup], frame: Frame, label: str) -> Markup:
    """The ``svg`` element; the label is for those who do not see it."""
    return element(
        "svg",
        *layers,
        class_="plot above",
        viewBox=f"0 0 {WIDTH:g} {frame.height:.1f}",
        role="img",
        aria_label=label,
    )


def frame_around(cameras: Float64Array, gaussians: Float64Array, reach: float = 0.0) -> Frame:
    """Holds all cameras, and most of the Gaussians where they do not lie too far away: beyond the
    reach, and more than in proportion to the cameras."""
    low, high = cameras.min(axis=0), cameras.max(axis=0)
    inner, outer = np.quantile(gaussians, [0.03, 0.97], axis=0)
    added = max(
        _FARTHEST * float(np.max(high - low)), _LEAST * float(np.max(outer - inner)), reach, 1e-3
    )
    low = np.minimum(low, np.maximum(inner, low - added))
    high = np.maximum(high, np.minimum(outer, high + added))
    margin = _MARGIN * float(np.max(high - low))
    low, high = low - margin, high + margin
    size, middle = high - low, (low + high) / 2
    # Neither a ribbon nor a tower.
    size = np.array([max(size[0], size[1] / 1.2), max(size[1], 0.4 * size[0])])
    return Frame(middle - size / 2, middle + size / 2)


def camera_layer(at: Float64Array, looking: Float64Array, kind: str) -> Markup:
    """All cameras of a kind as two paths: many are drawn.

    Args:
        at: (N, 2) pixels.
        looking: (N, 2) viewing directions in the picture, of length 1 or less.
        kind: class of the element.
    """
    ticks = "".join(
        f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"
        for (x, y), (dx, dy) in zip(at, _TICK * looking, strict=True)
    )
    dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in at)
    return element(
        "g",
        element("path", d=ticks, class_="tick"),
        element("path", d=dots, class_="dot"),
        class_=kind,
    )


def scale_bar(frame: Frame, metres_per_unit: float | None) -> Markup:
    """A length in metres, or in units where these are not known."""
    unit = metres_per_unit or 1.0
    length = round_down(0.2 * (frame.high[0] - frame.low[0]) * unit)
    text = f"{length:g} {'units' if metres_per_unit is None else 'm'}"
    x, y, width = 24.0, frame.height - 24.0, length / unit * frame.scale
    return element(
        "g",
        element("path", d=f"M{x:g} {y - 6:.1f}v6h{width:.1f}v-6", class_="bar"),
        element("text", text, x=x + width / 2, y=y - 8, text_anchor="middle", class_="halo"),
    )
