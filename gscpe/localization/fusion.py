# SPDX-License-Identifier: Apache-2.0
"""Combines the two estimates of a pose, from matches and from image alignment.

They err differently: matches by the map's geometry and the features' places, the alignment by
what changed between map and photo. The mean of the two is better than either, and a refinement
that has little to add cannot spoil a good coarse pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.geometry import se3
from gscpe.ranges import check_numbers

_LEAST = 1e-15
"""Share of the largest variance, below which one is rounding."""


@dataclass(frozen=True)
class FusionSettings:
    """How the coarse and the aligned pose are weighted, and how much the mean is better than they
    are (measured: docs/benchmarks.md).

    Attributes:
        matches_variance_factor: for the weights, the covariance of the matches counts this many
            times: of two estimates that share errors the better one, mostly the alignment,
            deserves more than its share by variance.
        correlation: of the errors of both, which see one photo and one map. The mean of two
            estimates that share all errors would be no better than either.

    Raises:
        SettingsError: a value is out of its range.
    """

    matches_variance_factor: float = 3.0
    correlation: float = 0.5

    def __post_init__(self) -> None:
        check_numbers(self, "matches_variance_factor", above=0)
        check_numbers(self, "correlation", least=0, most=1)


def fuse_matches_and_alignment(
    matched_cam_from_world: Float64Array,
    matched_covariance: Float64Array,
    aligned_cam_from_world: Float64Array,
    aligned_covariance: Float64Array,
    settings: FusionSettings,
    unshared: Float64Array | None = None,
) -> tuple[Float64Array, Float64Array]:
    """The mean of a coarse and an aligned pose, (4, 4), and its covariance, (6, 6), of xi in
    ``exp(xi) @ cam_from_world``; arguments as :func:`fuse_poses`.

    Along stripes, any place is like the next, so that matches are made between the same rows of
    both images: they agree with each other, and with a camera that has not moved. Their scatter
    does not tell. So the variance that the alignment has because the images share no gradients,
    ``unshared``, (6, 6), is theirs, too.
    """
    if unshared is not None:
        matched_covariance = matched_covariance + unshared
    return fuse_poses(
        matched_cam_from_world,
        matched_covariance,
        aligned_cam_from_world,
        aligned_covariance,
        settings.matches_variance_factor,
        settings.correlation,
    )


def fuse_poses(
    cam_from_world_a: Float64Array,
    covariance_a: Float64Array,
    cam_from_world_b: Float64Array,
    covariance_b: Float64Array,
    factor: float = 1.0,
    correlation: float = 0.0,
) -> tuple[Float64Array, Float64Array]:
    """The mean of two poses, weighted by their information, and its covariance.

    Args:
        cam_from_world_a, cam_from_world_b: (4, 4), close to each other.
        covariance_a, covariance_b: (6, 6) of xi in ``exp(xi) @ cam_from_world``.
        factor: for the weights alone, covariance_a counts this many times.
        correlation: of the errors of both, along the axes in which neither has covariances.
    """
    b_from_a = se3.log(cam_from_world_b @ se3.inverse(cam_from_world_a))
    # In units of a's deviations, so that metres and radians do not spoil the roots.
    scale = np.sqrt(np.diag(covariance_a))
    b = covariance_b / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(covariance_a / np.outer(scale, scale) + b)
    root = vectors * np.sqrt(np.maximum(values, _LEAST * values[-1]))
    whiten = (vectors / np.sqrt(np.maximum(values, _LEAST * values[-1]))).T
    # Axes along which a has the variance 1 - share, and b has share.
    share, axes = np.linalg.eigh(whiten @ b @ whiten.T)
    share = np.clip(share, 0.0, 1.0)
    of_b = factor * (1.0 - share) / (factor * (1.0 - share) + share)
    of_a = 1.0 - of_b
    variance = of_a**2 * (1.0 - share) + of_b**2 * share
    variance += 2.0 * correlation * of_a * of_b * np.sqrt(share * (1.0 - share))
    root = scale[:, None] * (root @ axes)
    step = root @ (of_b * (axes.T @ whiten @ (b_from_a / scale)))
    covariance = (root * variance) @ root.T
    return se3.exp(step) @ cam_from_world_a, 0.5 * (covariance + covariance.T)
