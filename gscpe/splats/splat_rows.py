# SPDX-License-Identifier: Apache-2.0
"""From the columns of a splat file to Gaussians: activations, and rows that are of no use.

Trainers and editors leave a few bad rows among millions: NaN where an optimizer diverged, zeros
where nothing was written. Viewers leave them out, and so is done here, with their number. A
splat of which most rows are bad is refused.
"""

from __future__ import annotations

import logging

import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array
from gscpe.errors import SplatError
from gscpe.splats.gaussians import LARGEST, GaussianScene, normalized_quaternions

_log = logging.getLogger(__name__)

_MOST_BAD = 0.5
_FLAT = np.float32(1e-3)  # thickness of a flat Gaussian, relative to its smallest extent
_LEAST = np.finfo(np.float32).smallest_normal


def gaussians_from_rows(
    what: str,
    means: Float32Array,
    log_scales: Float32Array,
    quaternions: Float32Array,
    logits: Float32Array,
    sh: Float32Array,
    antialiased: bool,
    origin: Float64Array,
) -> GaussianScene:
    """The Gaussians of the rows that can be used; a warning says how many cannot.

    Args:
        what: name of the file, for messages.
        means: (N, 3), relative to ``origin``.
        log_scales: (N, 3), or (N, 2) for the surfels of 2D Gaussian Splatting (Huang et al.,
            2024), whose normal is the third axis. An axis of no length, here or where a
            logarithm is -inf, gets a thousandth of the Gaussian's smallest other one.
        quaternions: (N, 4) of any length.
        logits: (N,) of the opacities; infinite ones are opaque or transparent.
        sh: (N, K, 3).
        antialiased, origin: see GaussianScene.

    Raises:
        SplatError: there are no rows, or most of them are bad.
    """
    count = len(means)
    with np.errstate(over="ignore", invalid="ignore"):  # what becomes infinite is left out
        scales = np.exp(log_scales)
        units = normalized_quaternions(quaternions)
        opacities = np.asarray(1.0 / (1.0 + np.exp(-logits)), dtype=np.float32)
    at_zero = means - (-origin).astype(np.float32)
    zeros = _all_zero(at_zero, log_scales, quaternions, logits[:, None], sh)
    scales, flat = _thickened(scales)
    values = (means, scales, units, opacities[:, None], sh)
    finite = np.logical_and.reduce([_all_finite(value) for value in values])
    bounded = np.logical_and.reduce([_all_bounded(value) for value in values])
    sized = np.all(scales > 0, axis=1)
    good = finite & bounded & sized & ~zeros
    bad = count - int(np.count_nonzero(good))
    if bad:
        kinds = (
            (~finite, "hold NaN or infinite values"),
            (finite & zeros, "are all zeros"),
            (finite & ~zeros & ~sized, "have no size"),
            (finite & ~zeros & sized & ~bounded, f"hold values beyond {LARGEST:.0e}"),
        )
        which = ", ".join(f"{n} {says}" for mask, says in kinds if (n := int(mask.sum())))
        if bad > _MOST_BAD * count:
            raise SplatError(
                f"{what}: {bad} of {count} Gaussians cannot be used ({which}): the splat is "
                "damaged; export it or train it again"
            )
        _log.warning("%s: %d of %d Gaussians are left out: %s", what, bad, count, which)
    if log_scales.shape[1] == 2:
        _log.warning("%s holds surfels of 2D Gaussian Splatting; they are drawn as flat Gaussians,"
                     " slightly unlike their training", what)  # fmt: skip
    elif n := int(np.count_nonzero(flat & good)):
        _log.warning("%s: %d of %d Gaussians are flat; they get a small thickness", what, n, count)
    keep = good if bad else slice(None)
    return GaussianScene(
        means=means[keep],
        quaternions=units[keep],
        scales=scales[keep],
        opacities=opacities[keep],
        sh=sh[keep],
        antialiased=antialiased,
        origin=origin,
    )


def _thickened(scales: Float32Array) -> tuple[Float32Array, BoolArray]:
    """(N, 3), where axes without length have a little, unless all are without; which were so."""
    if scales.shape[1] == 2:
        scales = np.concatenate([scales, np.zeros((len(scales), 1), np.float32)], axis=1)
    empty = scales < _LEAST  # exp(-inf), or what float32 cannot hold
    flat = np.any(empty, axis=1) & ~np.all(empty, axis=1)
    thin = np.where(empty, np.inf, scales).min(axis=1) * _FLAT
    thin = np.where(flat, np.maximum(thin, _LEAST), np.float32(0.0))
    return np.where(empty, thin[:, None], scales).astype(np.float32), np.asarray(flat)


def _all_finite(values: Float32Array) -> BoolArray:
    return np.asarray(np.isfinite(values).reshape(len(values), -1).all(axis=1))


def _all_bounded(values: Float32Array) -> BoolArray:
    return np.asarray((np.abs(values) <= LARGEST).reshape(len(values), -1).all(axis=1))


def _all_zero(*columns: Float32Array) -> BoolArray:
    each = [(values == 0).reshape(len(values), -1).all(axis=1) for values in columns]
    return np.asarray(np.logical_and.reduce(each))
