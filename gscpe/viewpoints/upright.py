# SPDX-License-Identifier: Apache-2.0
"""Which of a splat's main axes is up, from the splat alone."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.splats import GaussianScene
from gscpe.viewpoints.axes import solid, surface_normals
from gscpe.viewpoints.places import Place
from gscpe.viewpoints.space import Space

_USUAL_UP = np.array([0.0, 0.4, 0.2])
"""What is added for an axis of the file: most programs write y vertical (COLMAP: down; apps: up),
some z."""
_PARALLEL = 0.94
"""Cosine of the angle between a surface's normal and an axis that counts as the same."""


def axes_along(axes: Float64Array, up: Float64Array) -> Float64Array:
    """Main axes, (3, 3), turned so that one of them is along a given unit vector, or opposite."""
    vertical = int(np.argmax(np.abs(up @ axes)))
    turned = axes.copy()
    turned[:, vertical] = up * np.sign(up @ axes[:, vertical])
    first, second = (vertical + 1) % 3, (vertical + 2) % 3
    turned[:, first] -= (turned[:, first] @ up) * up
    turned[:, first] /= np.linalg.norm(turned[:, first])
    turned[:, second] = np.cross(turned[:, vertical], turned[:, first])
    return turned


def find_up(scene: GaussianScene, space: Space, places: Sequence[Place]) -> Float64Array:
    """The unit vector, (3,), that is up, one of the main axes or its opposite.

    The vertical axis: places are wide and low, and so is the space in which cameras were carried
    (good viewpoints); floors and tables are what most surfaces are parallel to. Its sign: more
    stands on the floor than hangs from the ceiling, and what was seen from above is sharper than
    what was seen from below.
    """
    vertical = int(np.argmax(_verticality(scene, space, places)))
    heights = scene.means[solid(scene)].astype(np.float64) @ space.axes[:, vertical]
    low, middle, high = np.quantile(heights, (0.02, 0.5, 0.98))
    lower_is_floor = float(np.log((high - middle + 1e-12) / (middle - low + 1e-12)))
    along, against = _sight(places)[2 * vertical : 2 * vertical + 2]
    return np.asarray(
        space.axes[:, vertical] * (1.0 if lower_is_floor >= along - against else -1.0)
    )


def _verticality(scene: GaussianScene, space: Space, places: Sequence[Place]) -> Float64Array:
    """Evidence, (3,), in natural logarithms."""
    extent = space.high - space.low
    weights = _weights(places)
    points = np.array([place.point for place in places])
    carried = np.sqrt(weights @ (points - weights @ points) ** 2) + 0.1 * np.median(extent)
    normals = np.abs(surface_normals(scene) @ space.axes)
    parallel = np.mean(normals > _PARALLEL, axis=0) + 0.01 if len(normals) else np.ones(3)
    terms = -np.log(extent), -np.log(carried), np.log(parallel)
    evidence = sum((term - np.median(term) for term in terms), np.zeros(3))
    return np.asarray(evidence + _USUAL_UP @ np.abs(space.axes))


def _weights(places: Sequence[Place]) -> Float64Array:
    best = np.array([place.best for place in places])
    weights = np.exp(best - best.max())
    return np.asarray(weights / weights.sum())


def _sight(places: Sequence[Place]) -> Float64Array:
    """Scores of the six views relative to the best of each place, (6,), each at least -2, on
    weighted average."""
    scores = np.array([np.maximum(place.scores - place.best, -2.0) for place in places])
    return np.asarray(_weights(places) @ scores)
