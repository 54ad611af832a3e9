# SPDX-License-Identifier: Apache-2.0
"""Gaussians as ``.spz`` with few that do not fit its rounding kept apart, exactly.

The format rounds all coordinates alike, to a share of the largest, and holds scales of seven
decimal orders. One floater a thousand kilometres away would round a room to centimetres; one
huge Gaussian would make all small ones larger. So steps are chosen for the many. What lies
beyond is kept apart as it is, and what was encoded is decoded and compared.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gscpe.arrays import BoolArray, Float32Array
from gscpe.errors import OutputError
from gscpe.splats.gaussians import GaussianScene, joined
from gscpe.splats.splat_file import splat_from_bytes
from gscpe.splats.spz import best_exponent, encode_spz

_log = logging.getLogger(__name__)

_SHARE_APART, _ALWAYS_APART = 0.05, 16
_SMALL_QUANTILE = 0.01  # of the largest extents: a small Gaussian's; some are specks
_COORDINATE_STEPS = 2.0**22  # at least so many between zero and the largest coordinate
_STEP, _THINNEST = 1 / 8, 1 / 20  # finest coordinate and scale wanted, in a small Gaussian's size
_E_FOLDS = 15.9  # from the smallest scale that the format holds to the largest
_BASE_RANGE, _HARMONICS_RANGE = 3.3, 0.98  # what a byte holds of coefficients
_CLIPPED = 0.25  # of a coefficient, by which it may be beyond

# How much rounding may change, of all but one in a hundred Gaussians.
_SHARE_WRONG = 0.01
_MOVED, _GROWN, _FADED, _COLOURED = 0.5, 0.05, 0.01, _CLIPPED + 0.05


@dataclass(frozen=True, eq=False)
class Compressed:
    """A scene in two parts.

    Attributes:
        spz: most of it, with lengths multiplied by two to the power of ``exponent``.
        exponent: see there.
        apart: the rest, as it is; None where all is in ``spz``.
    """

    spz: bytes
    exponent: int
    apart: GaussianScene | None


@dataclass(frozen=True, eq=False)
class Outliers:
    """Which Gaussians, (N,) bool, do not go with the others, and how many of each kind."""

    rows: BoolArray
    kinds: str


def compress(scene: GaussianScene) -> Compressed:
    """The scene, rounded; a warning says how many Gaussians are kept apart, and why. It is
    decoded again and compared.

    Raises:
        OutputError: sizes and distances differ too much for the format.
        MissingDependencyError: gaussforge is not installed.
    """
    apart = outliers(scene, colours=True)
    if apart.kinds:
        _log.warning(
            "%d of %d Gaussians are stored separately, without rounding, because "
            "with them the others would be rounded too coarsely: %s",
            apart.rows.sum(),
            len(scene),
            apart.kinds,
        )  # fmt: skip
    many = scene.taken(~apart.rows) if apart.kinds else scene
    exponent = best_exponent(many)
    spz = encode_spz(many, exponent)
    check_rounded(many, decompressed(splat_from_bytes(spz, Path("the map.spz")), 2.0**exponent))
    return Compressed(spz, exponent, scene.taken(apart.rows) if apart.kinds else None)


def decompressed(
    many: GaussianScene, factor: float, apart: GaussianScene | None = None
) -> GaussianScene:
    """The scene of what was read from the ``.spz``, whose lengths are divided by ``factor``, and
    of the Gaussians that were kept apart."""
    with np.errstate(over="ignore", divide="ignore"):  # GaussianScene reports what is infinite
        many = replace(
            many,
            means=np.asarray(many.means / factor, dtype=np.float32),
            scales=np.asarray(many.scales / factor, dtype=np.float32),
        )
    return many if apart is None else joined([many, apart])


def outliers(scene: GaussianScene, *, colours: bool) -> Outliers:
    """The few Gaussians that would spoil the others if they were rounded with them: far away, or
    huge. Where they are many, the scene is so, and none is an outlier.

    Args:
        scene: any.
        colours: also those that would be spoilt themselves: colours beyond the range of a byte.
    """
    count = len(scene)
    room = min(max(_ALWAYS_APART, int(_SHARE_APART * count)), count - 1)
    largest = scene.scales.max(axis=1).astype(np.float64)
    small = float(np.quantile(largest, _SMALL_QUANTILE))
    distance = np.abs(scene.means).max(axis=1)
    rows, kinds = np.zeros(count, dtype=bool), []
    for says, beyond in (
        ("far away", distance > _COORDINATE_STEPS * _STEP * small),
        ("huge", largest > math.exp(_E_FOLDS) * _THINNEST * small),
        ("of extreme colours", _clipped(scene) > (_CLIPPED if colours else np.inf)),
    ):
        new = int(np.count_nonzero(beyond & ~rows))
        if 0 < new <= room - int(rows.sum()):
            rows |= beyond
            kinds.append(f"{new} {says}")
    return Outliers(rows, ", ".join(kinds))


def check_rounded(before: GaussianScene, after: GaussianScene) -> None:
    """Raises OutputError where rounding changed more than it may, or lost Gaussians."""
    if len(after) != len(before):
        raise OutputError(f"of {len(before)} Gaussians, {len(after)} would be left")
    size = before.scales.max(axis=1)
    moved = np.linalg.norm(before.means.astype(np.float64) - after.means, axis=1) / size
    changes = (
        ("moved by more than half their size", moved, _MOVED),
        ("of another size", np.abs(np.log(after.scales.max(axis=1) / size)), _GROWN),
        ("of another opacity", np.abs(before.opacities - after.opacities), _FADED),
        ("of another colour", _farthest(before.sh - after.sh), _COLOURED),
    )
    for says, change, most in changes:
        wrong = int(np.count_nonzero(~(change <= most)))
        if wrong > _SHARE_WRONG * len(before):
            raise OutputError(
                f"{wrong} of {len(before)} Gaussians would be {says}: their distances, sizes or "
                "colours differ too much to be rounded alike"
            )


def _clipped(scene: GaussianScene) -> Float32Array:
    """By how much coefficients are beyond what a byte holds."""
    base = _farthest(scene.sh[:, :1]) - _BASE_RANGE
    return np.asarray(np.maximum(base, _farthest(scene.sh[:, 1:]) - _HARMONICS_RANGE))


def _farthest(coefficients: Float32Array) -> Float32Array:
    flat = np.abs(coefficients).reshape(len(coefficients), -1)
    return np.asarray(flat.max(axis=1, initial=0.0))
