# SPDX-License-Identifier: Apache-2.0
"""The splat as a browser draws it: fewer Gaussians, one colour each, cut by a section."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array, IntArray, UInt8Array
from gscpe.geometry.spread import evenly_spread
from gscpe.splats import GaussianScene
from gscpe.splats.gaussians import SH_C0

MOST_GAUSSIANS = 500_000
"""That a browser draws at several frames a second on an ordinary laptop."""

_FAINTEST = 1.0 / 255.0
_MOST_EYES = 64
_LARGEST = 6e4  # float16 ends at 65504
_ROUGHLY = 0.003
"""Share of the Gaussians beyond either end of a section's sliders: floaters far outside."""


@dataclass(frozen=True, eq=False)
class BrowserSplat:
    """Gaussians for the browser.

    Attributes:
        means: (N, 3) float32, map units.
        covariances: (N, 3, 3) float32.
        colours: (N, 3) uint8 RGB.
        opacities: (N, 1) uint8.
        total: Gaussians of the map, of which these are the most visible.
    """

    means: Float32Array
    covariances: Float32Array
    colours: UInt8Array
    opacities: UInt8Array
    total: int

    def __len__(self) -> int:
        return len(self.means)


def most_visible(scene: GaussianScene, most: int, eyes: Float64Array | None = None) -> IntArray:
    """Indices of at most so many Gaussians, ascending, as far as they are visible at all: the
    largest in opacity times area. With eyes, the area is that in the view of the nearest one, so
    that what cameras saw from near keeps its details.

    Args:
        scene: the splat.
        most: how many.
        eyes: (M, 3) from where it is looked at.
    """
    largest = np.sort(scene.scales.astype(np.float64), axis=1)[:, 1:]
    weight = scene.opacities * largest.prod(axis=1)
    if eyes is not None and len(eyes):
        weight /= np.maximum(_squared_distance(scene.means, eyes), scene.near**2)
    weight[scene.opacities < _FAINTEST] = 0.0
    seen = np.flatnonzero(weight > 0)
    if len(seen) > most:
        seen = seen[np.argpartition(-weight[seen], most - 1)[:most]]
    return np.sort(seen)


def _squared_distance(means: Float32Array, eyes: Float64Array) -> Float32Array:
    """(N,) to the nearest eye; of very many, some stand for all."""
    some = evenly_spread(len(eyes), _MOST_EYES)
    nearest = np.full(len(means), np.inf, dtype=np.float32)
    for eye in eyes[some].astype(np.float32):
        np.minimum(nearest, np.sum((means - eye) ** 2, axis=1), out=nearest)
    return nearest


def browser_splat(
    scene: GaussianScene, most: int = MOST_GAUSSIANS, eyes: Float64Array | None = None
) -> BrowserSplat:
    """The Gaussians that are worth sending (see :func:`most_visible`), with the constant part of
    their colour: browsers do not evaluate the part that depends on the direction."""
    kept = most_visible(scene, most, eyes)
    w, x, y, z = scene.quaternions[kept].T
    axes = np.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        axis=1,
    ).reshape(-1, 3, 3)
    stretched = axes * scene.scales[kept][:, None, :]
    colours = np.clip(0.5 + SH_C0 * scene.sh[kept, 0], 0.0, 1.0)
    return BrowserSplat(
        scene.means[kept],
        np.asarray(stretched @ stretched.transpose(0, 2, 1), dtype=np.float32),
        np.rint(255.0 * colours).astype(np.uint8),
        np.rint(255.0 * scene.opacities[kept]).astype(np.uint8)[:, None],
        len(scene),
    )


@dataclass(frozen=True, eq=False)
class Section:
    """A box that what is outside of is cut away.

    Attributes:
        axes: (3, 3), rows: unit vectors across, along and up.
        low, high: (3,) along the axes, map units; at an end of ``limits`` nothing is cut.
        limits: (2, 3): how far the box reaches at most.
    """

    axes: Float64Array
    low: Float64Array
    high: Float64Array
    limits: Float64Array

    @classmethod
    def around(cls, means: Float32Array, axes: Float64Array) -> Section:
        """The box that cuts nothing."""
        along = means @ axes.T
        limits = np.quantile(along, [_ROUGHLY, 1 - _ROUGHLY], axis=0)
        limits[1] = np.maximum(limits[1], limits[0] + 1e-6)
        return cls(axes, limits[0], limits[1], limits)

    def inside(self, means: Float32Array) -> BoolArray:
        """Which points, (N, 3), are shown, (N,)."""
        along = means @ self.axes.T
        low = np.where(self.low <= self.limits[0], -np.inf, self.low)
        high = np.where(self.high >= self.limits[1], np.inf, self.high)
        return np.asarray(np.all((along >= low) & (along <= high), axis=1))


def browser_unit(splat: BrowserSplat) -> float:
    """Browser units per map unit, a power of ten: covariances are sent as float16, which knows
    nothing below 6e-8."""
    typical = float(np.median(np.sqrt(np.trace(splat.covariances, axis1=1, axis2=2) / 3)))
    return float(10.0 ** np.clip(np.round(np.log10(0.1 / max(typical, 1e-9))), -3, 6))


def scaled_covariances(splat: BrowserSplat, unit: float) -> Float32Array:
    """Covariances, (N, 3, 3), in browser units; those beyond float16 become as large as it can
    hold."""
    scaled = splat.covariances * np.float32(unit**2)
    largest = np.abs(scaled).max(axis=(1, 2), keepdims=True)
    return np.asarray(scaled * np.minimum(1.0, _LARGEST / np.maximum(largest, 1e-30)), np.float32)
