# SPDX-License-Identifier: Apache-2.0
"""Absolute pose from 2D-3D matches: RANSAC with a prior, then robust least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import BoolArray, Float64Array, short_repr
from gscpe.coarse.least_squares import Matches2D3D
from gscpe.coarse.ransac import RansacSettings, sample_absolute_pose
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.information import covariance_from_information
from gscpe.ranges import check_numbers, check_whole

_MIN_POINTS = 4
_SMALLEST_STEP = 1e-7
"""Of Gauss-Newton, map units or radians: far below the deviation of any pose."""


@dataclass(frozen=True)
class PnPSettings(RansacSettings):
    """Settings of the absolute pose estimation: those of the sampling, and

    Attributes:
        noise_pixels: scale of the Cauchy weights of the final least squares (set on photos that are
            not reported, docs/benchmarks.md, as the other two).
        cells: columns of a grid of square cells over the photo. The matches of a cell share
            the errors of the map there: they count as one observation, however many.
        noise_correlation: neighbouring cells share errors too: so many count as one in the
            covariance (calibrated, docs/benchmarks.md).
    """

    noise_pixels: float = 0.7
    cells: int = 20
    noise_correlation: float = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, "noise_pixels", "noise_correlation", above=0)
        check_whole(self, "cells", least=1)


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
    matches = Matches2D3D(points_world, pixels, camera, settings.cells)
    counts = [
        matches.projected(cam_from_world).within(settings.inlier_pixels).sum()
        for cam_from_world in hypotheses
    ]
    if max(counts) < _MIN_POINTS:
        return None
    best = hypotheses[int(np.argmax(counts))]
    return pose_of_inliers(points_world, pixels, camera, best, settings)


def pose_of_inliers(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    settings: PnPSettings,
) -> AbsolutePose | None:
    """The pose that fits all matches near a first one best, and these matches; None where they are
    too few. Arguments as :func:`estimate_absolute_pose`, and the first pose, (4, 4)."""
    refined = refine_absolute_pose(points_world, pixels, camera, cam_from_world, settings)
    seen = Matches2D3D(points_world, pixels, camera, settings.cells).projected(refined)
    inliers = seen.within(settings.inlier_pixels)
    if inliers.sum() < _MIN_POINTS:
        return None
    return AbsolutePose(
        refined,
        inliers,
        float(np.sqrt(np.mean(seen.squared[inliers]))),
        _covariance(points_world[inliers], pixels[inliers], camera, refined, settings),
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
    matches = Matches2D3D(points_world, pixels, camera, settings.cells)
    for _ in range(iterations):
        equations = matches.equations(
            cam_from_world, 2.0 * settings.inlier_pixels, settings.noise_pixels, _MIN_POINTS
        )
        if equations is None:
            return cam_from_world
        step = equations.step()
        cam_from_world = se3.exp(step) @ cam_from_world
        if np.abs(step).max() < _SMALLEST_STEP:
            break
    return cam_from_world


def _covariance(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    settings: PnPSettings,
) -> Float64Array:
    """Of the robust least squares over the inliers, scaled by their residual variance."""
    matches = Matches2D3D(points_world, pixels, camera, settings.cells)
    equations = matches.equations(cam_from_world, np.inf, settings.noise_pixels, 1)
    assert equations is not None
    scale = settings.noise_correlation * max(equations.variance(), 1e-6)
    return scale * covariance_from_information(equations.hessian)
