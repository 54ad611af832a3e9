# SPDX-License-Identifier: Apache-2.0
"""Similarities, ``x_b = scale * rotation @ x_a + translation``, and their fit to poses.

The fit to points is in gscpe.geometry.alignment.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.geometry.pose_error import camera_centres, rotation_angle_degrees

_ALTERNATIONS = 20
_REWEIGHTINGS = 10
_MOST_STARTS = 300
_LEAST_SPREAD = 1e-12


@dataclass(frozen=True, eq=False)
class Similarity:
    """``b_from_a``: takes points of frame a into frame b.

    Attributes:
        scale: units of b a unit of a, > 0.
        rotation: (3, 3).
        translation: (3,), units of b.

    Raises:
        PoseError: a value is out of these bounds.
    """

    scale: float
    rotation: Float64Array
    translation: Float64Array

    def __post_init__(self) -> None:
        if not 0 < self.scale < np.inf:
            raise PoseError(f"the scale of a similarity must be positive, not {self.scale}")
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,):
            raise PoseError("a similarity needs a 3x3 rotation and three numbers of translation")
        orthonormal = np.allclose(self.rotation @ self.rotation.T, np.eye(3), atol=1e-4)
        if not orthonormal or np.linalg.det(self.rotation) < 0:
            raise PoseError("the rotation of a similarity is not a rotation matrix")
        if not np.all(np.isfinite(self.translation)):
            raise PoseError("the translation of a similarity is not finite")

    @classmethod
    def identity(cls) -> Similarity:
        """Changes nothing."""
        return cls(1.0, np.eye(3), np.zeros(3))

    @classmethod
    def of_matrix(cls, matrix: ArrayLike) -> Similarity:
        """Of a (4, 4) or (3, 4) matrix whose left part is a rotation times a scale.

        Raises:
            PoseError: it is not.
        """
        matrix = np.asarray(matrix, dtype=np.float64)
        if matrix.shape not in ((3, 4), (4, 4)) or not np.all(np.isfinite(matrix)):
            raise PoseError("a similarity is a 3x4 or 4x4 matrix of finite numbers")
        if len(matrix) == 4 and not np.allclose(matrix[3], (0, 0, 0, 1)):
            raise PoseError("the last row of a similarity's matrix is 0 0 0 1")
        determinant = float(np.linalg.det(matrix[:3, :3]))
        if determinant <= 0:
            raise PoseError("a similarity's matrix mirrors nothing and keeps all three dimensions")
        scale = float(np.cbrt(determinant))
        rotation = matrix[:3, :3] / scale
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
            raise PoseError("the matrix stretches or shears: it is not a rotation times a scale")
        return cls(scale, _nearest_rotation(rotation), matrix[:3, 3].copy())

    @property
    def matrix(self) -> Float64Array:
        """(4, 4), of homogeneous points."""
        result = np.eye(4)
        result[:3, :3] = self.scale * self.rotation
        result[:3, 3] = self.translation
        return result

    @property
    def degrees(self) -> float:
        """Angle of the rotation."""
        return rotation_angle_degrees(self.rotation)

    def apply(self, points: ArrayLike) -> Float64Array:
        """Points of a, (..., 3), in b."""
        points = np.asarray(points, dtype=np.float64)
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def inverse(self) -> Similarity:
        """``a_from_b``."""
        back = self.rotation.T
        return Similarity(1.0 / self.scale, back, -(back @ self.translation) / self.scale)

    def __matmul__(self, other: Similarity) -> Similarity:
        """``c_from_b @ b_from_a == c_from_a``."""
        return Similarity(
            self.scale * other.scale,
            self.rotation @ other.rotation,
            self.apply(other.translation),
        )

    def cam_from_b(self, cam_from_a: ArrayLike) -> Float64Array:
        """Poses of cameras, (..., 4, 4), with respect to b. Cameras are not scaled: their unit
        of length becomes that of b."""
        cam_from_a = np.asarray(cam_from_a, dtype=np.float64)
        moved = cam_from_a.copy()
        rotations = cam_from_a[..., :3, :3] @ self.rotation.T
        moved[..., :3, :3] = rotations
        moved[..., :3, 3] = self.scale * cam_from_a[..., :3, 3] - rotations @ self.translation
        return moved


@dataclass(frozen=True, eq=False)
class PosesFit:
    """A similarity of two sets of poses, and how well it fits.

    Attributes:
        b_from_a: the similarity.
        scale_sigma: standard deviation of its scale, relative; infinite where the cameras stand
            too near together to tell, so that the scale was held at 1.
        distances: (N,) of camera centres that remain, units of b.
        degrees: (N,) of rotations that remain.
        weights: (N,) in [0, 1], of each pose; 0 where it is an outlier.
    """

    b_from_a: Similarity
    scale_sigma: float
    distances: Float64Array
    degrees: Float64Array
    weights: Float64Array

    @property
    def rms_distance(self) -> float:
        """Root mean square of the distances, weighted; units of b."""
        return float(np.sqrt(np.average(self.distances**2, weights=self.weights)))

    @property
    def rms_degrees(self) -> float:
        """The same of the rotations."""
        return float(np.sqrt(np.average(self.degrees**2, weights=self.weights)))


def fit_similarity_of_poses(
    cam_from_b: ArrayLike,
    cam_from_a: ArrayLike,
    lever: float,
    max_scale_sigma: float = 0.02,
    floor: float = 1e-3,
) -> PosesFit:
    """The similarity ``b_from_a`` between two sets of poses of the same cameras.

    It minimizes, over the cameras, the squared distance of their centres, plus that of three
    points which are ``lever`` away along their axes and turn with them: so two cameras are enough,
    and cameras on one line are no problem. Outliers are found from the best of all pairs of
    cameras (of some, where there are many), and Tukey's weights keep them out.

    Args:
        cam_from_b, cam_from_a: (N, 4, 4), N >= 1.
        lever: how far away the surfaces are that the cameras see, units of b.
        max_scale_sigma: where the scale would be less sure than this (relative), it is held at 1.
        floor: deviation of a pose that is always believed, relative to the lever.
    """
    b, a = np.asarray(cam_from_b, dtype=np.float64), np.asarray(cam_from_a, dtype=np.float64)
    poses = _Poses(
        a[:, :3, :3],
        b[:, :3, :3],
        camera_centres(a),
        camera_centres(b),
        lever,
    )
    least = floor * lever
    fitted, scale_sigma = _robust_fit(poses, least, with_scale=len(a) >= 2)
    if not scale_sigma <= max_scale_sigma:
        fitted, _ = _robust_fit(poses, least, with_scale=False)
        scale_sigma = float("inf")
    distances, degrees = poses.remaining(fitted)
    residuals = poses.residuals(fitted)
    return PosesFit(fitted, scale_sigma, distances, degrees, _tukey(residuals, least))


@dataclass(frozen=True, eq=False)
class _Poses:
    """Rotations, (N, 3, 3), and centres, (N, 3), of the same cameras in two frames."""

    rotations_a: Float64Array
    rotations_b: Float64Array
    centres_a: Float64Array
    centres_b: Float64Array
    lever: float

    def remaining(self, b_from_a: Similarity) -> tuple[Float64Array, Float64Array]:
        distances = np.linalg.norm(b_from_a.apply(self.centres_a) - self.centres_b, axis=1)
        apart = self.rotations_b @ b_from_a.rotation @ self.rotations_a.transpose(0, 2, 1)
        chords = np.linalg.norm(apart - np.eye(3), axis=(1, 2)) / np.sqrt(8.0)
        return distances, np.degrees(2.0 * np.arcsin(np.minimum(chords, 1.0)))

    def residuals(self, b_from_a: Similarity) -> Float64Array:
        distances, degrees = self.remaining(b_from_a)
        return np.asarray(np.hypot(distances, np.sqrt(2.0) * self.lever * np.radians(degrees)))

    def fit(self, w: Float64Array, with_scale: bool) -> Similarity:
        w = w / w.sum()
        middle_a, middle_b = w @ self.centres_a, w @ self.centres_b
        a, b = self.centres_a - middle_a, self.centres_b - middle_b
        centres = (b * w[:, None]).T @ a
        turned = np.einsum("n,nji,njk->ik", w, self.rotations_b, self.rotations_a)
        spread = float(w @ (a**2).sum(axis=1))
        scale = 1.0
        rotation = np.eye(3)
        for _ in range(_ALTERNATIONS):  # rotation and scale depend on each other only a little
            rotation = _nearest_rotation(scale * centres + self.lever**2 * turned)
            if not with_scale or spread < _LEAST_SPREAD * self.lever**2:
                break
            before, scale = scale, float(np.sum(rotation * centres)) / spread
            if scale <= 0:
                scale = 1.0
                break
            if abs(scale - before) < 1e-12 * before:
                break
        return Similarity(scale, rotation, middle_b - scale * rotation @ middle_a)

    def scale_sigma(self, b_from_a: Similarity, w: Float64Array) -> float:
        """Relative, from what remains of the centres."""
        w = w / w.sum()
        distances, _ = self.remaining(b_from_a)
        a = self.centres_a - w @ self.centres_a
        spread = b_from_a.scale**2 * float(w @ (a**2).sum(axis=1))
        effective = 1.0 / float(w @ w)
        free = max(3.0 * effective - 7.0, 1.0)
        variance = effective * float(w @ distances**2) / free
        return float(np.sqrt(variance / max(effective * spread, _LEAST_SPREAD * self.lever**2)))


def _robust_fit(poses: _Poses, least: float, with_scale: bool) -> tuple[Similarity, float]:
    count = len(poses.centres_a)
    starts = [np.ones(count)]
    for chosen in _samples(count, 2 if with_scale else 1):
        weights = np.zeros(count)
        weights[list(chosen)] = 1.0
        starts.append(weights)
    tried = [poses.fit(weights, with_scale) for weights in starts]
    best = min(tried, key=lambda each: float(np.median(poses.residuals(each))))
    weights = np.ones(count)
    for _ in range(_REWEIGHTINGS):
        weights = _tukey(poses.residuals(best), least)
        best = poses.fit(weights, with_scale)
    return best, poses.scale_sigma(best, weights)


def _samples(count: int, size: int) -> list[tuple[int, ...]]:
    """All choices of so many poses; some of them, the same every time, where there are too many to
    try."""
    if count**size <= 2 * _MOST_STARTS:
        return list(combinations(range(count), size))
    rng = np.random.default_rng(0)
    drawn = {tuple(sorted(rng.choice(count, size, replace=False))) for _ in range(_MOST_STARTS)}
    return [tuple(int(index) for index in each) for each in sorted(drawn)]


def _tukey(residuals: Float64Array, least: float) -> Float64Array:
    """Tukey's weights of positive residuals, whose median is theirs of three to six dimensions."""
    cut = 4.0 * max(float(np.median(residuals)), least)
    return np.asarray(np.maximum(1.0 - (residuals / cut) ** 2, 0.0) ** 2)


def _nearest_rotation(matrix: Float64Array) -> Float64Array:
    """The rotation R that maximizes trace(R^T M)."""
    u, _, vt = np.linalg.svd(matrix)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return np.asarray((u * signs) @ vt)
