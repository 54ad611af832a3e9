"""The motion, with or without a scale, that best moves one set of points onto another.

S. Umeyama, "Least-squares estimation of transformation parameters between two point
patterns", IEEE TPAMI 13(4), 1991.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array


@dataclass(frozen=True, eq=False)
class Similarity:
    """``x_b = scale * rotation @ x_a + translation``; a rigid motion where the scale is 1."""

    rotation: Float64Array
    translation: Float64Array
    scale: float = 1.0

    def points(self, points_a: Float64Array) -> Float64Array:
        """(..., 3) points of frame a in frame b."""
        return np.asarray(self.scale * points_a @ self.rotation.T + self.translation)

    def cam_from_b(self, cam_from_a: Float64Array) -> Float64Array:
        """Poses, (..., 4, 4), of the same cameras in frame b, in the unit of b."""
        rotation = cam_from_a[..., :3, :3] @ self.rotation.T
        centres = -np.einsum("...ji,...j->...i", cam_from_a[..., :3, :3], cam_from_a[..., :3, 3])
        moved = np.array(cam_from_a)
        moved[..., :3, :3] = rotation
        moved[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation, self.points(centres))
        return moved


def umeyama(points_a: Float64Array, points_b: Float64Array, with_scale: bool = True) -> Similarity:
    """The least-squares similarity from a to b, in closed form.

    Points on one line, or all in one place, leave the rotation open; then it is one of the best.

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
    return Similarity(rotation, mean_b - scale * rotation @ mean_a, scale)
