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


@dataclass(frozen=True)
class FusionSettings:
    """How the coarse and the aligned pose are weighted.

    Attributes:
        matches_variance_factor: both see one photo and one map, so that part of their errors is
            the same; and of two such estimates the better one, the alignment, deserves more than
            its share by variance. So the covariance of the matches counts this many times
            (calibrated, docs/benchmarks.md).
    """

    matches_variance_factor: float = 4.0

    def __post_init__(self) -> None:
        check_numbers(self, "matches_variance_factor", above=0)


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
    matched_covariance = settings.matches_variance_factor * matched_covariance
    if unshared is not None:
        matched_covariance = matched_covariance + unshared
    return fuse_poses(
        matched_cam_from_world,
        matched_covariance,
        aligned_cam_from_world,
        aligned_covariance,
    )


def fuse_poses(
    cam_from_world_a: Float64Array,
    covariance_a: Float64Array,
    cam_from_world_b: Float64Array,
    covariance_b: Float64Array,
) -> tuple[Float64Array, Float64Array]:
    """The mean of two independent poses, weighted by their information, and its covariance.

    Args:
        cam_from_world_a, cam_from_world_b: (4, 4), close to each other.
        covariance_a, covariance_b: (6, 6) of xi in ``exp(xi) @ cam_from_world``.
    """
    b_from_a = se3.log(cam_from_world_b @ se3.inverse(cam_from_world_a))
    # In units of a's deviations, so that metres and radians do not spoil the inverse.
    scale = np.sqrt(np.diag(covariance_a))
    a, b = covariance_a / np.outer(scale, scale), covariance_b / np.outer(scale, scale)
    weight_of_b = np.linalg.solve((a + b).T, a.T).T  # a (a + b)^-1
    step = scale * (weight_of_b @ (b_from_a / scale))
    covariance = weight_of_b @ b
    covariance = 0.5 * (covariance + covariance.T) * np.outer(scale, scale)
    return se3.exp(step) @ cam_from_world_a, covariance
