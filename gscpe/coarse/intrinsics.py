# SPDX-License-Identifier: Apache-2.0
"""Pose and camera that fit matches with the map best; and so, whether a given camera is right."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gscpe.arrays import Float64Array, short_repr
from gscpe.coarse.least_squares import BEHIND, Matches2D3D
from gscpe.coarse.pnp import PnPSettings
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.information import covariance_from_information
from gscpe.geometry.intrinsics import FOCAL, changed_camera
from gscpe.geometry.projection import transform_points

_ITERATIONS = 50
_MIN_MATCHES = 8
"""Of two coordinates each: for eleven numbers, with some to spare."""
_LONGEST_STEP = 0.2
"""Of each of the camera's numbers, so that a first step from far away does not turn it over."""
_LEAST_VARIANCE = 1e-6  # pixels squared, of matches that fit exactly

_BENT = 4.0 / 3.0
"""Times ``PnPSettings.noise_correlation``, where the camera is sought: what a map is bent by looks
like a camera (calibrated, docs/benchmarks.md)."""

FOCAL_ALONE = (np.inf, 0.0, 0.0, 0.0, 0.0)
"""Standard deviations of the five numbers of a camera of which only the focal length is sought."""


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """A pose and a camera, estimated together.

    Attributes:
        camera: that fits the matches.
        cam_from_world: (4, 4).
        change: (5,) from the camera that was given to this one: of ln(f), ln(fy / fx), cx / fx,
            cy / fy and k1, see ``Camera.covariance``.
        covariance: (5, 5) of these numbers.
        inliers: matches that agree.
    """

    camera: Camera
    cam_from_world: Float64Array
    change: Float64Array
    covariance: Float64Array
    inliers: int

    @property
    def ratio(self) -> float:
        """Of its focal length to that of the camera that was given."""
        return float(np.exp(self.change[FOCAL]))

    @property
    def relative_sigma(self) -> float:
        """Standard deviation of the focal length, as a share of it."""
        return float(np.sqrt(self.covariance[FOCAL, FOCAL]))

    def __repr__(self) -> str:
        return short_repr(self)


def solve_intrinsics(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    pnp: PnPSettings,
    sigmas: tuple[float, ...] = FOCAL_ALONE,
    change: Float64Array | None = None,
    smallest_step: float = 1e-6,
) -> CameraEstimate | None:
    """Gauss-Newton over the pose and the camera, from a start that is near enough: the most
    probable ones; None when few matches agree with it.

    Args:
        points_world: (N, 3).
        pixels: (N, 2), the centre of the top-left pixel at (0.5, 0.5).
        camera: pinhole camera of the pixels.
        cam_from_world: (4, 4), the start.
        pnp: thresholds of the matches.
        sigmas: standard deviations of the camera's five numbers beforehand, see
            :mod:`gscpe.geometry.intrinsics`; infinite: nothing is known, 0: it is exact.
        change: (5,) of the camera, where to start.
        smallest_step: of all numbers, which ends the iteration.
    """
    matches = Matches2D3D(points_world, pixels, camera, pnp.cells)
    change = np.zeros(5) if change is None else change
    deviations = np.array(sigmas)
    free = np.concatenate([np.full(6, True), deviations > 0])
    its, known = np.ix_(free, free), np.zeros(11)
    known[6:][free[6:]] = deviations[free[6:]] ** -2.0
    for _ in range(_ITERATIONS):
        # Wider than an inlier: the camera may still be off by a step.
        equations = matches.equations(
            cam_from_world, 3 * pnp.inlier_pixels, pnp.noise_pixels, _MIN_MATCHES, change
        )
        if equations is None:
            return None
        scatter = max(equations.variance(), _LEAST_VARIANCE)
        variance = _BENT * pnp.noise_correlation * scatter
        gradient = equations.gradient - variance * known * np.concatenate([np.zeros(6), change])
        hessian = (equations.hessian + variance * np.diag(known))[its]
        step = np.zeros(11)
        step[free] = replace(equations, hessian=hessian, gradient=gradient[free]).step()
        cam_from_world = se3.exp(step[:6]) @ cam_from_world
        change = change + np.clip(step[6:], -_LONGEST_STEP, _LONGEST_STEP)
        if np.abs(step).max() < smallest_step:
            break
    covariance = np.zeros((11, 11))
    covariance[its] = variance * covariance_from_information(hessian)
    inliers = matches.projected(cam_from_world, change).within(pnp.inlier_pixels)
    return CameraEstimate(
        changed_camera(camera, change),
        cam_from_world,
        change,
        covariance[6:, 6:],
        int(inliers.sum()),
    )


_STARTS = (1.0, 0.8, 0.9, 1.11, 1.25)
"""Multiples of the given focal length to begin from; the first wins where it is as good."""
_BETTER = 1.02
"""Times as many matches must agree with a later start as with an earlier one."""

_DOUBTED = (np.inf, 0.02, 0.05, 0.05, 0.2)
"""Standard deviations beforehand of what may be wrong with a given camera."""

_SAMPLE, _LARGE_SAMPLE = 300, 800
"""Matches that are enough to choose a start, and to check the camera: this must cost little."""
_ROUGH, _FINE = 1e-3, 1e-4
"""Smallest steps for either."""


def check_intrinsics(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    cam_from_world: Float64Array,
    pnp: PnPSettings,
) -> CameraEstimate | None:
    """The camera that most matches agree on, found from a pose that was solved for with a
    given one; None when few agree on any.

    With a wrong focal length the camera seems to be too near or too far, and only matches of one
    depth agree; so other focal lengths are begun from too, the camera moved along its axis until
    the middle of the scene looks the same.

    Arguments as :func:`solve_intrinsics`; ``cam_from_world``: (4, 4), of the given camera.
    """
    depths = transform_points(cam_from_world, points_world)[:, 2]
    ahead = depths[depths > BEHIND]
    if not len(ahead):
        return None
    few, enough = (
        slice(None, None, max(1, len(pixels) // sample)) for sample in (_SAMPLE, _LARGE_SAMPLE)
    )
    some_points, some_pixels = points_world[few], pixels[few]  # are enough to choose a start
    best: CameraEstimate | None = None
    for factor in _STARTS:
        if best is not None and len(some_pixels) <= _BETTER * best.inliers:
            break  # hardly any is left that could agree with another
        start = cam_from_world.copy()
        start[2, 3] += (factor - 1.0) * float(np.median(ahead))
        change = np.log(factor) * np.eye(5)[FOCAL]
        found = solve_intrinsics(
            some_points, some_pixels, camera, start, pnp, FOCAL_ALONE, change, _ROUGH
        )
        if found is not None and (best is None or found.inliers > _BETTER * best.inliers):
            best = found
    if best is None:
        return None
    found = solve_intrinsics(
        *(points_world[enough], pixels[enough], camera, best.cam_from_world),
        *(pnp, _DOUBTED, best.change, _FINE),
    )
    if found is None:
        return None
    inliers = Matches2D3D(points_world, pixels, camera, pnp.cells).projected(
        found.cam_from_world, found.change
    )
    return replace(found, inliers=int(inliers.within(pnp.inlier_pixels).sum()))
