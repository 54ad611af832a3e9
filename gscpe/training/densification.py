# SPDX-License-Identifier: Apache-2.0
"""Which Gaussians are split, which are dropped: a budget is spent where photos still differ."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import BoolArray, Float32Array, IntArray
from gscpe.training.parameters import Parameters
from gscpe.training.settings import TrainingSettings

_APART = 0.5  # of the longest axis: where the two halves are centred
_LONG, _SHORT = 0.7, 0.9  # what becomes of the longest axis, and of the others
_SHARE_OF_OPACITY = 0.7  # of -log(1 - opacity) that each half gets; they overlap


def is_kept(parameters: Parameters, extent: float, settings: TrainingSettings) -> BoolArray:
    """False, (N,), for Gaussians that are too faint or too large."""
    bright = parameters.opacities >= settings.prune_opacity
    small = parameters.scales.max(axis=1) <= settings.prune_scale * extent
    return np.asarray(bright & small)


def to_split(scores: Float32Array, round_: int, settings: TrainingSettings) -> IntArray:
    """Which Gaussians to split in a round, ascending.

    The number grows geometrically to the budget in the last round, within the bounds set; those
    with the greatest mean gradient on the screen are taken, but none below ``split_gradient``.

    Args:
        scores: (N,) mean lengths of the gradients.
        round_: its number, from 1.
        settings: budget and bounds.
    """
    count = len(scores)
    left = max(settings.densify_rounds - round_ + 1, 1)
    growth = (settings.max_gaussians / count) ** (1.0 / left) - 1.0
    growth = min(max(growth, settings.least_growth), settings.most_growth)
    room = min(int(growth * count), settings.max_gaussians - count)
    if room <= 0:
        return np.zeros(0, dtype=np.intp)
    best = np.argsort(-scores, kind="stable")[:room]
    return np.sort(best[scores[best] >= settings.split_gradient])


def split(parameters: Parameters, chosen: IntArray) -> Parameters:
    """The Gaussians, each chosen one as two halves side by side along its longest axis."""
    parents = parameters.take(chosen)
    rows = np.arange(len(chosen))
    longest = parents.scales.argmax(axis=1)
    axes = _axes(parents.quaternions)[rows, :, longest]
    offsets = np.float32(_APART) * parents.scales[rows, longest][:, None] * axes
    shrunk = np.full((len(chosen), 3), np.log(_SHORT), dtype=np.float32)
    shrunk[rows, longest] = np.log(_LONG)
    log_scales = parents.log_scales + shrunk
    # log(1 - opacity) = -softplus(logit)
    each = np.float32(_SHARE_OF_OPACITY) * np.logaddexp(np.float32(0.0), parents.logits)
    logits = np.log(np.expm1(np.maximum(each, np.float32(1e-6))))
    halves = [
        Parameters.new(
            means=np.asarray(parents.means + sign * offsets, dtype=np.float32),
            log_scales=log_scales.copy(),
            quaternions=parents.quaternions.copy(),
            logits=np.asarray(logits, dtype=np.float32).copy(),
            sh=parents.sh.copy(),
        )
        for sign in (np.float32(1.0), np.float32(-1.0))
    ]
    others = np.ones(len(parameters), dtype=np.bool_)
    others[chosen] = False
    return parameters.take(np.flatnonzero(others)).joined(halves[0]).joined(halves[1])


def _axes(quaternions: Float32Array) -> Float32Array:
    """The rotations of unit quaternions, (N, 3, 3)."""
    w, x, y, z = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.asarray(np.moveaxis(np.array(rows), 2, 0), dtype=np.float32)
