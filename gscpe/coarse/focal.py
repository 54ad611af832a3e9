"""The focal length of an unknown camera, from matches with the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import BoolArray, Float64Array, short_repr
from gscpe.coarse.pnp import PnPSettings, cell_crowds, solve_observed
from gscpe.coarse.ransac import sample_absolute_pose
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.information import covariance_from_information
from gscpe.geometry.projection import pose_jacobian, project, transform_points

_BEHIND = 1e-6
_ITERATIONS = 50


@dataclass(frozen=True)
class FocalSettings:
    """How a focal length is looked for.

    Attributes:
        widest, narrowest: bounds, as multiples of the guess.
        steps: focal lengths tried between them, evenly in the logarithm.
        around: bounds of the second round, as a multiple of what the first one found.
        ordinary: focal length of an ordinary lens, in widths of the longer side: the guess where
            there is no other.
        min_inliers: matches that must agree with the best.
        max_relative_sigma: largest standard deviation over focal length that is an answer: a
            flat wall looks alike from far with a long lens, and from near with a short one.
    """

    widest: float = 0.5
    narrowest: float = 2.0
    steps: int = 13
    around: float = 1.15
    ordinary: float = 0.9
    min_inliers: int = 30
    max_relative_sigma: float = 0.03


@dataclass(frozen=True, eq=False)
class FocalEstimate:
    """A pose, and the focal length that goes with it.

    Attributes:
        camera: of one focal length, principal point as in the guess.
        cam_from_world: (4, 4).
        relative_sigma: standard deviation of the focal length, as a share of it.
        inliers: matches that agree.
    """

    camera: Camera
    cam_from_world: Float64Array
    relative_sigma: float
    inliers: int

    def __repr__(self) -> str:
        return short_repr(self)


def estimate_focal_length(
    points_world: Float64Array,
    pixels: Float64Array,
    guess: Camera,
    pnp: PnPSettings,
    settings: FocalSettings,
) -> FocalEstimate | str:
    """Pose and focal length that most matches agree on; a string says why there is none.

    Focal lengths around the guess are tried, each with RANSAC; from the best one, pose and
    focal length are solved for together, with robust weights.

    Args:
        points_world: (N, 3).
        pixels: (N, 2), the centre of the top-left pixel at (0.5, 0.5).
        guess: pinhole camera of the pixels.
        pnp: thresholds of the matches.
        settings: see :class:`FocalSettings`.
    """
    best: tuple[int, Camera, Float64Array] | None = None
    for factor in np.geomspace(settings.widest, settings.narrowest, settings.steps):
        camera = _with_focal(guess, factor * guess.fx)
        cam_from_world = sample_absolute_pose(
            points_world,
            pixels,
            camera,
            pnp,
        )
        if cam_from_world is None:
            continue
        near, _ = _near(points_world, pixels, camera, cam_from_world, pnp.inlier_pixels)
        if best is None or near.sum() > best[0]:
            best = int(near.sum()), camera, cam_from_world
    if best is None or best[0] < settings.min_inliers:
        found = 0 if best is None else best[0]
        return f"only {found} matches agree with any focal length ({settings.min_inliers} needed)"
    return _refined(points_world, pixels, best[1], best[2], pnp, settings)


def _refined(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    pnp: PnPSettings,
    settings: FocalSettings,
) -> FocalEstimate | str:
    """Gauss-Newton over the pose and the logarithm of the focal length."""
    for _ in range(_ITERATIONS):
        # Wider than an inlier: the focal length may still be off by a step.
        near, squared = _near(points_world, pixels, camera, cam_from_world, 3 * pnp.inlier_pixels)
        if near.sum() < settings.min_inliers:
            return "the matches do not agree on a focal length"
        points_in_cam = transform_points(cam_from_world, points_world[near])
        predicted = project(camera, points_in_cam)
        residuals = pixels[near] - predicted
        weights = 1.0 / (1.0 + squared[near] / pnp.noise_pixels**2)
        weights /= cell_crowds(pixels[near], camera, pnp.cells)
        by_focal = predicted - np.array([camera.cx, camera.cy])
        jacobian = np.concatenate(
            [pose_jacobian(camera, points_in_cam), by_focal[:, :, None]], axis=2
        )
        hessian = np.einsum("nri,n,nrj->ij", jacobian, weights, jacobian)
        step = solve_observed(hessian, np.einsum("nri,n,nr->i", jacobian, weights, residuals))
        cam_from_world = se3.exp(step[:6]) @ cam_from_world
        camera = _with_focal(camera, camera.fx * float(np.exp(np.clip(step[6], -0.2, 0.2))))
        if np.abs(step).max() < 1e-8:
            break
    variance = float(np.sum(weights * squared[near]) / (2.0 * np.sum(weights)))
    covariance = pnp.noise_correlation * variance * covariance_from_information(hessian)
    sigma = float(np.sqrt(covariance[6, 6]))
    if sigma > settings.max_relative_sigma:
        return (
            f"the matches leave it open (standard deviation {sigma:.0%}), as those of a flat wall "
            "do; give the intrinsics"
        )
    near, _ = _near(points_world, pixels, camera, cam_from_world, pnp.inlier_pixels)
    return FocalEstimate(camera, cam_from_world, sigma, int(near.sum()))


def _near(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    threshold: float,
) -> tuple[BoolArray, Float64Array]:
    """Which matches reproject within the threshold, and squared errors in pixels, (N,) each."""
    points_in_cam = transform_points(cam_from_world, points_world)
    ahead = points_in_cam[:, 2] > _BEHIND
    points_in_cam[~ahead] = (0.0, 0.0, 1.0)
    squared = np.sum((pixels - project(camera, points_in_cam)) ** 2, axis=1)
    return ahead & (squared < threshold**2), squared


def _with_focal(camera: Camera, focal: float) -> Camera:
    return Camera.pinhole(
        camera.width, camera.height, fx=focal, fy=focal, cx=camera.cx, cy=camera.cy
    )
