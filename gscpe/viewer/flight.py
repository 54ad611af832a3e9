# SPDX-License-Identifier: Apache-2.0
"""Moves the eye of a browser."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gscpe.geometry import se3
from gscpe.viewer.cameras import Viewpoint, between

if TYPE_CHECKING:
    import viser

_SECONDS = 0.6
_STEPS = 18


@dataclass(frozen=True)
class Flight:
    """How the eye moves in a map.

    Attributes:
        unit: browser units in a map unit.
        depth: of what cameras see, map units; the eye turns about a point so far ahead.
    """

    unit: float
    depth: float

    def fly(self, client: viser.ClientHandle, goal: Viewpoint) -> None:
        """From where the eye is to the goal, slowly at both ends; returns when it is there."""
        camera = client.camera
        begin = Viewpoint(
            np.array(camera.position) / self.unit, np.array(camera.wxyz), float(camera.fov)
        )
        for step in range(1, _STEPS + 1):
            share = step / _STEPS
            self.put(client, between(begin, goal, share * share * (3.0 - 2.0 * share)))
            time.sleep(_SECONDS / _STEPS)

    def put(self, client: viser.ClientHandle, point: Viewpoint) -> None:
        """The eye is there at once."""
        turn = se3.from_quaternion_translation(point.quaternion, [0, 0, 0])[:3, :3]
        position = self.unit * point.position
        with client.atomic():
            client.camera.position = position
            client.camera.look_at = position + self.unit * self.depth * turn[:, 2]
            client.camera.up_direction = -turn[:, 1]
            client.camera.fov = point.vertical_angle
        client.flush()
