# SPDX-License-Identifier: Apache-2.0
"""The focal length of an unknown camera, from matches with the map."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gscpe.arrays import Float64Array, short_repr
from gscpe.coarse.least_squares import Matches2D3D
from gscpe.coarse.pnp import PnPSettings
from gscpe.coarse.ransac import sample_absolute_pose
from gscpe.errors import SettingsError
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.information import covariance_from_information
from gscpe.geometry.projection import transform_points

_BEHIND = 1e-6
_ITERATIONS = 50
_MIN_MATCHES = 8
_SAMPLE = 300
_ROUGH = 1e-3


@dataclass(frozen=True)
class FocalSettings:
    """How a focal length is estimated.

    Attributes:
        widest, narrowest: bounds, as multiples of the guess.
        steps: focal lengths tried between them, evenly in the logarithm.
        around: bounds of the second round, as a multiple of what the first one found.
        ordinary: focal length of an ordinary lens, in widths of the longer side: the guess where
            there is no other.
        min_inliers: matches that must agree with the best.
        max_relative_sigma: largest relative standard deviation of an accepted focal length: a flat
            wall looks the same from far away with a long lens as from nearby with a short one.
        principal_sigma: standard deviation of the principal point of such a camera, which is not
            estimated but taken to be the guess's, as a share of the focal length.

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
    principal_sigma: float = 0.01

    def __post_init__(self) -> None:
        if not 0 < self.widest <= 1 <= self.narrowest < np.inf or self.steps < 1:
            raise SettingsError(
                "focal lengths need widest in (0, 1], narrowest of at least 1 and steps >= 1, not "
                f"{self.widest}, {self.narrowest} and {self.steps}"
            )
        if not (1 <= self.around < np.inf and 0 < self.ordinary < np.inf):
            raise SettingsError("around is a factor of at least 1, ordinary a positive length")
        if self.min_inliers < 1 or not self.max_relative_sigma > 0:
            raise SettingsError("a focal length needs min_inliers >= 1 and max_relative_sigma > 0")
        if not 0 <= self.principal_sigma < np.inf:
            raise SettingsError(f"principal_sigma cannot be {self.principal_sigma}; 0 or more")


@dataclass(frozen=True, eq=False)
class FocalEstimate:
    """A pose and a focal length, estimated together.

    Attributes:
        camera: with the guess's principal point and ratio of focal lengths.
        cam_from_world: (4, 4).
        ratio: of its focal lengths to those of the camera that was given.
        relative_sigma: standard deviation of the focal length, as a share of it.
        inliers: matches that agree.
    """

    camera: Camera
    cam_from_world: Float64Array
    ratio: float
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
    matches = Matches2D3D(points_world, pixels, guess, pnp.cells)
    best: tuple[int, Camera, Float64Array] | None = None
    for factor in np.geomspace(settings.widest, settings.narrowest, settings.steps):
        camera = _times(guess, factor)
        cam_from_world = sample_absolute_pose(
            points_world,
            pixels,
            camera,
            pnp,
        )
        if cam_from_world is None:
            continue
        inliers = matches.projected(cam_from_world, factor).within(pnp.inlier_pixels)
        if best is None or inliers.sum() > best[0]:
            best = int(inliers.sum()), camera, cam_from_world
    if best is None or best[0] < settings.min_inliers:
        agreeing = 0 if best is None else best[0]
        return (
            f"only {agreeing} matches agree with any focal length ({settings.min_inliers} needed)"
        )
    found = solve_focal_length(points_world, pixels, best[1], best[2], pnp)
    if found is None or found.inliers < settings.min_inliers:
        return "the matches do not agree on a focal length"
    if found.relative_sigma > settings.max_relative_sigma:
        return (
            f"the matches do not determine it (standard deviation {found.relative_sigma:.0%}), "
            "as with a flat wall; give the intrinsics"
        )
    camera = replace(
        found.camera,
        focal_sigma=found.relative_sigma,
        principal_sigma=settings.principal_sigma,
    )
    return replace(found, camera=camera)


_STARTS = (1.0, 0.8, 0.9, 1.11, 1.25)
"""Multiples of the given focal length to begin from; the first wins where it is as good."""


_BETTER = 1.02
"""Times as many matches must agree with a later start as with an earlier one."""


def check_focal_length(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    pnp: PnPSettings,
) -> FocalEstimate | None:
    """The focal length that most matches agree on, found from a pose that was solved for with a
    given one; None when few agree on any.

    With a wrong one the camera seems to be too near or too far, and only matches of one depth
    agree; so other focal lengths are begun from too, the camera moved along its axis until the
    middle of the scene looks the same.

    Arguments as :func:`estimate_focal_length`; ``cam_from_world``: (4, 4), of the given camera.
    """
    depths = transform_points(cam_from_world, points_world)[:, 2]
    ahead = depths[depths > _BEHIND]
    if not len(ahead):
        return None
    few = slice(None, None, max(1, len(pixels) // _SAMPLE))  # are enough to choose a start
    some_points, some_pixels = points_world[few], pixels[few]
    best: FocalEstimate | None = None
    for factor in _STARTS:
        if best is not None and len(some_pixels) <= _BETTER * best.inliers:
            break  # hardly any is left that could agree with another
        start = cam_from_world.copy()
        start[2, 3] += (factor - 1.0) * float(np.median(ahead))
        found = solve_focal_length(
            some_points, some_pixels, _times(camera, factor), start, pnp, _ROUGH
        )
        if found is not None and (best is None or found.inliers > _BETTER * best.inliers):
            best = found
    if best is None:
        return None
    found = solve_focal_length(points_world, pixels, best.camera, best.cam_from_world, pnp)
    return found and replace(found, ratio=float(found.camera.fx / camera.fx))


def solve_focal_length(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    pnp: PnPSettings,
    smallest_step: float = 1e-6,
) -> FocalEstimate | None:
    """Gauss-Newton over the pose and the logarithm of the focal length, from a start that is near
    enough; None when few matches agree with it.

    Arguments as :func:`estimate_focal_length`; ``cam_from_world``: (4, 4), the start;
    ``smallest_step``: of all seven numbers, which ends the iteration.
    """
    matches = Matches2D3D(points_world, pixels, camera, pnp.cells)
    zoom = 1.0
    for _ in range(_ITERATIONS):
        # Wider than an inlier: the focal length may still be off by a step.
        equations = matches.equations(
            cam_from_world, 3 * pnp.inlier_pixels, pnp.noise_pixels, _MIN_MATCHES, zoom
        )
        if equations is None:
            return None
        step = equations.step()
        cam_from_world = se3.exp(step[:6]) @ cam_from_world
        zoom *= float(np.exp(np.clip(step[6], -0.2, 0.2)))
        if np.abs(step).max() < smallest_step:
            break
    assert equations is not None
    covariance = covariance_from_information(equations.hessian)
    sigma = float(np.sqrt(pnp.noise_correlation * equations.variance() * covariance[6, 6]))
    inliers = matches.projected(cam_from_world, zoom).within(pnp.inlier_pixels)
    return FocalEstimate(_times(camera, zoom), cam_from_world, zoom, sigma, int(inliers.sum()))


def _times(camera: Camera, factor: float) -> Camera:
    return replace(camera, fx=factor * camera.fx, fy=factor * camera.fy)
