# SPDX-License-Identifier: Apache-2.0
"""Which way is up, as far as the cameras tell."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import Float64Array

_COMMON = 0.5
"""Length of the mean of unit up vectors above which cameras agree on what is up."""

_TRUST_IN_UP = 0.1


def common_up(cam_from_world: Float64Array) -> Float64Array | None:
    """The unit vector, (3,), that is up in the world; None where the cameras have no common up.

    People hold cameras level more often than they point them at the horizon, so up is the
    direction most at right angles to the cameras' x axes; their own up vectors decide where
    all look the same way.

    Args:
        cam_from_world: (N, 4, 4) of upright photos; N may be 0.
    """
    right, own_up = cam_from_world[:, 0, :3], -cam_from_world[:, 1, :3]
    if not len(cam_from_world) or np.linalg.norm(own_up.mean(axis=0)) < _COMMON:
        return None
    cost = right.T @ right - _TRUST_IN_UP * own_up.T @ own_up
    up = np.linalg.eigh(cost)[1][:, 0]
    return np.asarray(up if up @ own_up.mean(axis=0) > 0 else -up)
