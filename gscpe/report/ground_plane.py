"""From which direction a scene is seen from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float64Array

_COMMON = 0.5
"""Length of the mean of unit up vectors above which cameras agree on what is up."""

_TRUST_IN_UP = 0.1


@dataclass(frozen=True, eq=False)
class GroundPlane:
    """Directions of a picture that is seen from above.

    Attributes:
        axes: (2, 3) unit vectors in the world: to the right, and to the top of the picture.
        up: (3,) unit vector towards the eye, ``cross(*axes)``.
        why: how it was chosen, for people.
    """

    axes: Float64Array
    up: Float64Array
    why: str

    def flat(self, points: Float64Array) -> Float64Array:
        """World points, (..., 3), as (..., 2)."""
        return np.asarray(points @ self.axes.T)


def choose_ground_plane(cam_from_world: Float64Array, centres: Float64Array) -> GroundPlane:
    """The plane of a picture from above.

    People hold cameras level more often than they point them at the horizon, so up is the
    direction most at right angles to the cameras' x axes; their own up vectors decide where
    all look the same way. Where cameras have no common up, two principal axes of the
    positions are taken.

    Args:
        cam_from_world: (N, 4, 4) of the reference photos; N may be 0.
        centres: (M, 3) of all cameras that will be drawn, M > 0.
    """
    spread = _principal_axes(centres)
    right, own_up = cam_from_world[:, 0, :3], -cam_from_world[:, 1, :3]
    if len(cam_from_world) and np.linalg.norm(own_up.mean(axis=0)) >= _COMMON:
        cost = right.T @ right - _TRUST_IN_UP * own_up.T @ own_up
        up = np.linalg.eigh(cost)[1][:, 0]
        up = up if up @ own_up.mean(axis=0) > 0 else -up
        why = (
            "Up is the direction most at right angles to the image rows of the reference photos; "
            "the longer extent of the camera positions is horizontal."
        )
    else:
        up = spread[2]
        why = (
            "The reference photos have no common up direction: the picture shows the two "
            "principal axes of the camera positions."
        )
    level = centres - np.outer(centres @ up, up)
    across = _principal_axes(level)[0]
    across -= (across @ up) * up
    if np.linalg.norm(across) < 1e-6:  # all cameras stand above each other
        across = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    across /= np.linalg.norm(across)
    return GroundPlane(np.stack([across, np.cross(up, across)]), up, why)


def _principal_axes(points: Float64Array) -> Float64Array:
    """(3, 3), rows by falling variance."""
    centred = points - points.mean(axis=0)
    return np.asarray(np.linalg.eigh(centred.T @ centred)[1][:, ::-1].T)
