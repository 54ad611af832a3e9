# SPDX-License-Identifier: Apache-2.0
"""The three directions at right angles that most surfaces of a splat face."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import BoolArray, Float64Array
from gscpe.splats import GaussianScene

_SAMPLES = 3000
_STARTS = 12
_STEPS = 30
_FLAT = 0.3
"""A Gaussian is flat where its smallest axis is below so many times the next."""
_SOLID = 0.3
_HUGE = 0.99
"""Quantile of the sizes beyond which Gaussians are background, not surface."""


def solid(scene: GaussianScene) -> BoolArray:
    """Gaussians that are part of surfaces, (N,): opaque, and not among the few huge ones."""
    largest = scene.scales.max(axis=1)
    opaque = scene.opacities >= min(_SOLID, float(np.quantile(scene.opacities, 0.5)))
    return np.asarray(opaque & (largest <= np.quantile(largest, _HUGE)))


def main_axes(scene: GaussianScene) -> Float64Array:
    """Axes in the columns of a rotation, (3, 3), that normals of surfaces agree with most.

    Gaussians on surfaces become flat in training; their shortest axis is the surface's normal.
    The rotation maximizes the mean fourth power of the normals' coordinates, by the fixed point
    of its gradient from several starts. Where nothing is flat, these are the axes of the file.
    """
    normals = surface_normals(scene)
    if len(normals) < 100:
        return np.eye(3)
    from scipy.spatial.transform import Rotation  # takes longer to import than all else

    starts = [np.eye(3), *Rotation.random(_STARTS, random_state=0).as_matrix()]
    found = []
    for start in starts:
        axes = start
        for _ in range(_STEPS):
            left, _, right = np.linalg.svd(normals.T @ (normals @ axes) ** 3)
            axes = left @ right
        found.append((float(np.mean((normals @ axes) ** 4)), axes))
    best = max(found, key=lambda each: each[0])[1]
    return np.asarray(best if np.linalg.det(best) > 0 else -best)


def surface_normals(scene: GaussianScene) -> Float64Array:
    """Unit normals, (M, 3), of flat, solid Gaussians, the more often the more they cover; (0, 3)
    where there are none."""
    from scipy.spatial.transform import Rotation

    rows = np.flatnonzero(solid(scene))
    order = np.argsort(scene.scales[rows], axis=1)
    scales = np.take_along_axis(scene.scales[rows], order, axis=1).astype(np.float64)
    flat = scales[:, 0] < _FLAT * scales[:, 1]
    rows, order, scales = rows[flat], order[flat], scales[flat]
    if not len(rows):
        return np.zeros((0, 3))
    covered = scene.opacities[rows] * scales[:, 1] * scales[:, 2]
    if not covered.sum() > 0:
        return np.zeros((0, 3))
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(rows), _SAMPLES, p=covered / covered.sum())
    axes = Rotation.from_quat(scene.quaternions[rows[chosen]], scalar_first=True).as_matrix()
    return np.asarray(axes[np.arange(len(chosen)), :, order[chosen, 0]])
