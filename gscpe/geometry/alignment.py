# SPDX-License-Identifier: Apache-2.0
"""The motion, with or without a scale, that best moves one set of points onto another.

S. Umeyama, "Least-squares estimation of transformation parameters between two point
patterns", IEEE TPAMI 13(4), 1991.
"""

from __future__ import annotations

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry.similarity_transform import Similarity


def umeyama(points_a: Float64Array, points_b: Float64Array, with_scale: bool = True) -> Similarity:
    """The least-squares similarity from a to b, in closed form.

    Points on one line, or all in one place, leave the rotation open; then it is one of the best.
    Points all in one place leave the scale open; then it is 1.

    Args:
        points_a, points_b: (N, 3) corresponding points, at least one.
        with_scale: False: a rigid motion.
    """
    mean_a, mean_b = points_a.mean(axis=0), points_b.mean(axis=0)
    a, b = points_a - mean_a, points_b - mean_b
    u, singular, vt = np.linalg.svd(b.T @ a / len(a))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * signs) @ vt
    spread = float(np.mean(np.sum(a**2, axis=1)))
    scale = float(singular @ signs) / spread if with_scale and spread > 0.0 else 1.0
    scale = scale if scale > 0.0 else 1.0
    return Similarity(scale, rotation, mean_b - scale * rotation @ mean_a)
