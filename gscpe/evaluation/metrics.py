# SPDX-License-Identifier: Apache-2.0
"""The field's numbers: median errors, and shares within thresholds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import PoseError
from gscpe.geometry import se3
from gscpe.geometry.pose_error import PoseDifference, pose_difference

THRESHOLDS = ((0.10, 5.0), (0.05, 5.0), (0.02, 2.0), (0.01, 1.0))
"""Position (metres) and rotation (degrees) within which a photo counts as localized."""


@dataclass(frozen=True)
class Evaluation:
    """How good a set of poses is.

    Attributes:
        queries: photos in the truth list.
        localized: those that have an estimate.
        median_distance, median_degrees: over the localized photos; NaN where there are none.
            The distance is in metres, or in units whose length is not known.
        shares: for each of THRESHOLDS, the share of *all* queries within it: a photo that
            was not localized counts as a failure. NaN where the unit is not known.
        ignored: estimates whose photo is not in the truth list.
    """

    queries: int
    localized: int
    median_distance: float
    median_degrees: float
    shares: tuple[float, ...]
    ignored: int


def normalized_error_squared(
    cam_from_world: Float64Array, covariance: Float64Array, true_cam_from_world: Float64Array
) -> float:
    """``xi^T C^-1 xi`` of the error xi, ``exp(xi) @ cam_from_world == true_cam_from_world``.

    Averages 6 over many photos when the covariances, (6, 6), are right (chi squared); more
    when they promise too much.
    """
    xi = se3.log(true_cam_from_world @ se3.inverse(cam_from_world))
    return float(xi @ np.linalg.solve(covariance, xi))


def expected_error(covariance: Float64Array, metres_per_unit: float = 1.0) -> PoseDifference:
    """The root mean square error that a covariance promises, to stand beside a pose's error.

    The root of the trace of either half: a pose's standard deviations in three directions
    together. The distance is that of the camera centres, since ``exp(xi)`` moves the centre by
    the translation of xi, turned into the world.

    Args:
        covariance: (6, 6) of xi in ``exp(xi) @ cam_from_world``, (translation, rotation), map
            units and radians.
        metres_per_unit: of the map; the distance is given in metres.
    """
    return PoseDifference(
        metres_per_unit * float(np.sqrt(np.trace(covariance[:3, :3]))),
        float(np.degrees(np.sqrt(np.trace(covariance[3:, 3:])))),
    )


def evaluate(
    estimates: Mapping[str, Float64Array],
    truth: Mapping[str, Float64Array],
    metres_per_unit: float | None = 1.0,
) -> Evaluation:
    """Compares estimated with true ``cam_from_world``, (4, 4) each, by photo name.

    Args:
        estimates, truth: poses by name, in the same frame and unit.
        metres_per_unit: of both; distances are given in metres. None: unknown; then they are in
            units, and the shares, whose limits are metres, are NaN.

    Raises:
        PoseError: the truth is empty, or no estimate is of a photo in it.
    """
    if not truth:
        raise PoseError("the truth list is empty")
    common = [name for name in truth if name in estimates]
    if estimates and not common:
        raise PoseError(
            "no estimate has a name of the truth list; "
            f"for example {next(iter(estimates))!r} against {next(iter(truth))!r}"
        )
    errors = [pose_difference(estimates[name], truth[name]) for name in common]
    unit = 1.0 if metres_per_unit is None else metres_per_unit
    distances = unit * np.array([error.distance for error in errors])
    degrees = np.array([error.degrees for error in errors])
    return Evaluation(
        queries=len(truth),
        localized=len(common),
        median_distance=float(np.median(distances)) if common else float("nan"),
        median_degrees=float(np.median(degrees)) if common else float("nan"),
        shares=tuple(
            float("nan")
            if metres_per_unit is None
            else float(np.count_nonzero((distances <= metres) & (degrees <= limit)) / len(truth))
            for metres, limit in THRESHOLDS
        ),
        ignored=len(estimates) - len(common),
    )
