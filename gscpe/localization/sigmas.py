# SPDX-License-Identifier: Apache-2.0
"""How sure a pose is in its worst direction, for limits and for people."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.scene import MapFrame
from gscpe.scene.map_frame import TYPICAL_DEPTH

_HALF_A_TURN = 180.0


def worst_sigmas(covariance: Float64Array, tolerance_unit: float) -> tuple[float, float]:
    """Metres and degrees in the worst direction.

    In ``exp(xi)`` the camera's centre moves by minus the translation, turned, and by what the
    rotation does to it, which is nothing: the centre is the origin of its own frame.
    """
    translation, rotation = (
        float(np.sqrt(max(np.linalg.eigvalsh(block)[-1], 0.0)))
        for block in (covariance[:3, :3], covariance[3:, 3:])
    )
    return translation * tolerance_unit, float(np.degrees(rotation))


def sigmas_text(metres: float, degrees: float, tolerance_unit: float, frame: MapFrame) -> str:
    """Standard deviations of a pose in the worst direction, for people. Those that are as long as
    the view is deep, or half a turn, are of a linear model far beyond where it holds: it only says
    that nothing is known, not how little.

    Args:
        metres, degrees: see :func:`worst_sigmas`.
        tolerance_unit: of the pose, with respect to the map.
        frame: of the map.
    """
    length = frame.length_text(min(metres, TYPICAL_DEPTH) / tolerance_unit)
    return (
        f"standard deviations of {'more than ' if metres > TYPICAL_DEPTH else ''}{length} and "
        f"{'more than 180' if degrees > _HALF_A_TURN else f'{degrees:.2f}'} degrees"
    )
