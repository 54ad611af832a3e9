# SPDX-License-Identifier: Apache-2.0
"""Absolute pose from 2D-3D matches: RANSAC with a prior, then robust least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import BoolArray, Float64Array, short_repr
from gscpe.coarse.ransac import RansacSettings, sample_absolute_pose
from gscpe.errors import SettingsError
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.information import covariance_from_information
from gscpe.geometry.projection import pose_jacobian, project, transform_points

_MIN_POINTS = 4
_BEHIND = 1e-6
_SMALLEST_STEP = 1e-7
"""Of Gauss-Newton, map units or radians: far below the deviation of any pose."""


@dataclass(frozen=True)
class PnPSettings(RansacSettings):
    """Settings of the absolute pose estimation: those of the sampling, and

    Attributes:
        noise_pixels: scale of the Cauchy weights of the final least squares.
        cells: columns of a grid of square cells over the photo. The matches of a cell share
            the errors of the map there: they count as one observation, however many.
        noise_correlation: neighbouring cells share errors too: so many count as one in the
            covariance (calibrated, docs/benchmarks.md).
    """

    noise_pixels: float = 1.0
    cells: int = 10
    noise_correlation: float = 1.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.noise_pixels <= 0:
            raise SettingsError(f"the noise must be positive, not {self.noise_pixels} pixels")
        if self.cells < 1:
            raise SettingsError(f"the grid needs at least one column, not {self.cells}")


@dataclass(frozen=True, eq=False)
class AbsolutePose:
    """A pose and the evidence for it.

    Attributes:
        cam_from_world: (4, 4).
        inliers: (N,) bool, matches within the inlier threshold.
        rms_pixels: of the inliers' reprojection errors.
        covariance: (6, 6) of xi in ``exp(xi) @ cam_from_world``, (translation, rotation).
    """

    cam_from_world: Float64Array
    inliers: BoolArray
    rms_pixels: float
    covariance: Float64Array

    def __repr__(self) -> str:
        return short_repr(self)


def estimate_absolute_pose(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    prior_cam_from_world: Float64Array,
    settings: PnPSettings,
) -> AbsolutePose | None:
    """The pose that most matches agree on, or None when there is none.

    The prior competes with the RANSAC pose as a hypothesis, so that a good prior is
    never lost to an unlucky sample.

    Args:
        points_world: (N, 3).
        pixels: (N, 2), the centre of the top-left pixel at (0.5, 0.5).
        camera: pinhole camera of the pixels.
        prior_cam_from_world: (4, 4), the pose before.
        settings: see :class:`PnPSettings`.
    """
    if len(points_world) < _MIN_POINTS:
        return None
    hypotheses = [prior_cam_from_world]
    sampled = sample_absolute_pose(
        points_world,
        pixels,
        camera,
        settings,
    )
    if sampled is not None:
        hypotheses.append(sampled)
    counts = [
        _inliers(points_world, pixels, camera, cam_from_world, settings).sum()
        for cam_from_world in hypotheses
    ]
    if max(counts) < _MIN_POINTS:
        return None
    best = hypotheses[int(np.argmax(counts))]
    refined = refine_absolute_pose(points_world, pixels, camera, best, settings)
    inliers = _inliers(points_world, pixels, camera, refined, settings)
    if inliers.sum() < _MIN_POINTS:
        return None
    points_world, pixels = points_world[inliers], pixels[inliers]
    errors = _reprojection_errors(points_world, pixels, camera, refined)
    return AbsolutePose(
        refined,
        inliers,
        float(np.sqrt(np.mean(errors**2))),
        _covariance(points_world, pixels, errors, camera, refined, settings),
    )


def refine_absolute_pose(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    settings: PnPSettings,
    iterations: int = 20,
) -> Float64Array:
    """Gauss-Newton on the reprojection error with Cauchy weights over all near matches; those
    of one cell of the photo count as one."""
    for _ in range(iterations):
        points_in_cam = transform_points(cam_from_world, points_world)
        ahead = points_in_cam[:, 2] > _BEHIND
        points_in_cam = points_in_cam[ahead]
        residuals = pixels[ahead] - project(camera, points_in_cam)
        squared = np.sum(residuals**2, axis=1)
        near = squared < (2.0 * settings.inlier_pixels) ** 2
        if near.sum() < _MIN_POINTS:
            return cam_from_world
        weights = 1.0 / (1.0 + squared[near] / settings.noise_pixels**2)
        weights /= cell_crowds(pixels[ahead][near], camera, settings.cells)
        jacobian = pose_jacobian(camera, points_in_cam[near])
        step = solve_observed(*normal_equations(jacobian, weights, residuals[near]))
        cam_from_world = se3.exp(step) @ cam_from_world
        if np.abs(step).max() < _SMALLEST_STEP:
            break
    return cam_from_world


def cell_crowds(pixels: Float64Array, camera: Camera, cells: int) -> Float64Array:
    """How many of the pixels, (N, 2), lie in the cell of each, (N,)."""
    column, row = np.floor(pixels * (cells / camera.width)).astype(np.int64).T
    _, which, counts = np.unique(
        row * (4 * cells) + column, return_inverse=True, return_counts=True
    )  # columns differ by less than that: matches lie in the photo
    return counts[which].astype(np.float64)


def _covariance(
    points_world: Float64Array,
    pixels: Float64Array,
    errors: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    settings: PnPSettings,
) -> Float64Array:
    """Of the robust least squares over the inliers, scaled by their residual variance."""
    jacobian = pose_jacobian(camera, transform_points(cam_from_world, points_world))
    weights = 1.0 / (1.0 + errors**2 / settings.noise_pixels**2)
    weights /= cell_crowds(pixels, camera, settings.cells)
    variance = np.sum(weights * errors**2) / (2.0 * np.sum(weights))
    hessian, _ = normal_equations(jacobian, weights, np.zeros((len(pixels), 2)))
    scale = settings.noise_correlation * max(float(variance), 1e-6)
    return scale * covariance_from_information(hessian)


def normal_equations(
    jacobian: Float64Array, weights: Float64Array, residuals: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """``sum w J^T J``, (U, U), and ``sum w J^T r``, (U,), of (N, 2, U) Jacobians, (N,) weights and
    (N, 2) residuals."""
    flat = jacobian.reshape(-1, jacobian.shape[2])
    weighted = flat * np.repeat(weights, 2)[:, None]
    return weighted.T @ flat, weighted.T @ residuals.reshape(-1)


def solve_observed(hessian: Float64Array, gradient: Float64Array) -> Float64Array:
    """Solves for the step; directions that the points do not determine are not moved."""
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-12))
    inverse = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=1e-9, hermitian=True)
    return np.asarray(inverse @ (gradient / scale) / scale)


def _reprojection_errors(
    points_world: Float64Array, pixels: Float64Array, camera: Camera, cam_from_world: Float64Array
) -> Float64Array:
    """Pixels, (N,); infinite behind the camera."""
    points_in_cam = transform_points(cam_from_world, points_world)
    ahead = points_in_cam[:, 2] > _BEHIND
    points_in_cam[~ahead] = (0.0, 0.0, 1.0)
    errors = np.linalg.norm(project(camera, points_in_cam) - pixels, axis=1)
    return np.where(ahead, errors, np.inf)


def _inliers(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    settings: PnPSettings,
) -> BoolArray:
    errors = _reprojection_errors(points_world, pixels, camera, cam_from_world)
    return np.asarray(errors < settings.inlier_pixels)
