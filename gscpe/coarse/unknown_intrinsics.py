# SPDX-License-Identifier: Apache-2.0
"""Cameras of which nobody wrote down the intrinsics, from matches with the map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Sequence

import cv2
import numpy as np

from gscpe.arrays import Float64Array
from gscpe.coarse.intrinsics import FOCAL_ALONE, CameraEstimate, solve_intrinsics
from gscpe.coarse.least_squares import Matches2D3D
from gscpe.coarse.pnp import PnPSettings
from gscpe.coarse.ransac import sample_absolute_pose
from gscpe.geometry.camera import Camera
from gscpe.geometry.intrinsics import FOCAL, PRINCIPAL_X, PRINCIPAL_Y, RADIAL, changed_camera
from gscpe.ranges import check_numbers, check_whole


@dataclass(frozen=True)
class IntrinsicsSettings:
    """How an unknown camera is estimated: its focal length from matches alone; the others are
    known to some deviation beforehand, and matches say what they can.

    Attributes:
        widest, narrowest: bounds of the focal length, as multiples of the guess.
        steps: focal lengths tried between them, evenly in the logarithm.
        around: bounds of the second round, as a multiple of what the first one found.
        ordinary: focal length of an ordinary lens, in widths of the longer side: the guess where
            there is no other.
        min_inliers: matches that must agree with the best.
        max_relative_sigma: largest relative standard deviation of an accepted focal length: a flat
            wall looks the same from far away with a long lens as from nearby with a short one.
        aspect_sigma: standard deviation of fy / fx from that of the guess, beforehand.
        principal_sigma: ... of either coordinate of the principal point, as a share of the focal
            length.
        radial_sigma: ... of k1, the coefficient of radial distortion.
        plain: of many cameras the principal point lies in the middle, and of many the lens does not
            distort, or the distortion was removed: the probability of each, beforehand.
        plain_sigmas: standard deviation of the principal point then, and of k1, as a share of
            ``principal_sigma`` and ``radial_sigma``.
        covariance_factor: the covariance of what comes of all this counts so many times
            (calibrated, docs/benchmarks.md): lenses are not quite like this, nor maps.

    Raises:
        SettingsError: a value is out of its range.
    """

    widest: float = 0.5
    narrowest: float = 2.0
    steps: int = 13
    around: float = 1.15
    ordinary: float = 0.9
    min_inliers: int = 30
    max_relative_sigma: float = 0.03
    aspect_sigma: float = 0.003
    principal_sigma: float = 0.015
    radial_sigma: float = 0.05
    plain: float = 0.5
    plain_sigmas: float = 0.125
    covariance_factor: float = 1.6

    def __post_init__(self) -> None:
        check_numbers(self, "widest", above=0, most=1)
        check_numbers(self, "narrowest", "around", least=1)
        check_numbers(self, "ordinary", above=0)
        check_whole(self, "steps", "min_inliers", least=1)
        check_numbers(self, "max_relative_sigma", above=0, infinite=True)
        check_numbers(self, "aspect_sigma", "principal_sigma", "radial_sigma", above=0)
        check_numbers(self, "plain", above=0, below=1)
        check_numbers(self, "plain_sigmas", above=0, most=1)
        check_numbers(self, "covariance_factor", above=0)

    @property
    def sigmas(self) -> tuple[float, ...]:
        """Of the five numbers of a camera (:mod:`gscpe.geometry.intrinsics`)."""
        principal = self.principal_sigma
        return np.inf, self.aspect_sigma, principal, principal, self.radial_sigma


def estimate_intrinsics(
    points_world: Float64Array,
    pixels: Float64Array,
    guess: Camera,
    pnp: PnPSettings,
    settings: IntrinsicsSettings,
    change: Float64Array | None = None,
) -> CameraEstimate | str:
    """Pose and camera that most matches agree on; a string says why there is none.

    Focal lengths around the guess are tried, each with RANSAC; from the best one, pose and
    focal length are solved for together, with robust weights, and then the whole camera.

    Args:
        points_world: (N, 3).
        pixels: (N, 2), the centre of the top-left pixel at (0.5, 0.5).
        guess: pinhole camera of the pixels.
        pnp: thresholds of the matches.
        settings: see :class:`IntrinsicsSettings`.
        change: (5,) of the guess, where something better is known by now.
    """
    matches = Matches2D3D(points_world, pixels, guess, pnp.cells)
    change = np.zeros(5) if change is None else change
    best: tuple[int, Float64Array, Float64Array] | None = None
    for factor in np.geomspace(settings.widest, settings.narrowest, settings.steps):
        tried = change + np.log(factor) * np.eye(5)[FOCAL]
        camera = changed_camera(guess, tried)
        cam_from_world = sample_absolute_pose(
            points_world, _without_distortion(pixels, camera), camera, pnp
        )
        if cam_from_world is None:
            continue
        agreeing = int(matches.projected(cam_from_world, tried).within(pnp.inlier_pixels).sum())
        if best is None or agreeing > best[0]:
            best = agreeing, tried, cam_from_world
    if best is None or best[0] < settings.min_inliers:
        agreeing = 0 if best is None else best[0]
        return (
            f"only {agreeing} matches agree with any focal length ({settings.min_inliers} needed)"
        )
    _, change, cam_from_world = best
    for sigmas in (FOCAL_ALONE, settings.sigmas):
        found = solve_intrinsics(points_world, pixels, guess, cam_from_world, pnp, sigmas, change)
        if found is None or found.inliers < settings.min_inliers:
            return "the matches do not agree on a focal length"
        change, cam_from_world = found.change, found.cam_from_world
    assert found is not None
    if found.relative_sigma > settings.max_relative_sigma:
        return (
            f"the matches do not determine it (standard deviation {found.relative_sigma:.0%}), "
            "as with a flat wall; give the intrinsics"
        )
    return replace(found, camera=probable_camera(guess, [found], settings))


def _without_distortion(pixels: Float64Array, camera: Camera) -> Float64Array:
    if camera.is_pinhole:
        return pixels
    matrix, distortion = camera.matrix(), np.asarray(camera.distortion)
    found = cv2.undistortPoints(pixels[:, None], matrix, distortion, P=matrix)
    return np.asarray(found, dtype=np.float64)[:, 0]


def probable_camera(
    guess: Camera, estimates: Sequence[CameraEstimate], settings: IntrinsicsSettings
) -> Camera:
    """The camera of one photo, or of several, with its covariance: the mean over what it may be
    like beforehand, a plain one or not in each respect, by how probable that is after all matches.

    Args:
        guess: that the estimates begin from; its own distortion was removed before.
        estimates: from each photo, with the settings' deviations beforehand.
        settings: see :class:`IntrinsicsSettings`.
    """
    known = np.array(settings.sigmas) ** -2.0
    information, pull = np.zeros((5, 5)), np.zeros(5)
    for estimate in estimates:
        found = np.linalg.inv(estimate.covariance)
        information += found - np.diag(known)
        pull += found @ estimate.change
    means, covariances, scores = [], [], []
    for middle, straight in product((False, True), repeat=2):
        expected = known.copy()
        expected[[PRINCIPAL_X, PRINCIPAL_Y]] *= settings.plain_sigmas**-2.0 if middle else 1.0
        expected[RADIAL] *= settings.plain_sigmas**-2.0 if straight else 1.0
        covariance = np.linalg.inv(information + np.diag(expected))
        means.append(covariance @ pull)
        covariances.append(covariance)
        # Logarithms of the evidence: Gaussians integrated, but for what all have in common.
        fit = 0.5 * (pull @ means[-1] + np.linalg.slogdet(covariance)[1])
        scores.append(fit + 0.5 * np.sum(np.log(expected[1:])))
        scores[-1] += (middle + straight) * np.log(settings.plain / (1.0 - settings.plain))
    weights = np.exp(np.array(scores) - max(scores))
    weights /= weights.sum()
    change = weights @ np.array(means)
    apart = np.array(means) - change
    within = np.tensordot(weights, np.array(covariances), 1)
    between = (weights[:, None] * apart).T @ apart
    covariance = settings.covariance_factor * (within + between)
    return changed_camera(guess, change).with_covariance(covariance)
