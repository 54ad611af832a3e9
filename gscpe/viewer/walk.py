# SPDX-License-Identifier: Apache-2.0
"""A trajectory in the browser: its line, a camera that moves along it, the slider of its time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.geometry import se3
from gscpe.viewer.camera_nodes import add_frustum
from gscpe.viewer.cameras import TRAJECTORY, ShownCamera, viewpoint_of
from gscpe.viewer.contents import Trajectory
from gscpe.viewer.flight import Flight

if TYPE_CHECKING:
    import viser

_PIECE = 250
"""Poses whose line is one node: of a trajectory that grows, only the last one is sent again."""


class Walk:
    """A trajectory, which may grow; see :meth:`show`. Made where the panel is being filled.

    Args:
        server: of the page.
        unit: browser units in a map unit.
        flight: moves the eyes that ride along.
        grows: whether the camera is at the newest pose until somebody moves the slider.

    Attributes:
        trajectory: that is shown, or None.
    """

    def __init__(self, server: viser.ViserServer, unit: float, flight: Flight, grows: bool) -> None:
        self._server, self._unit, self._flight = server, unit, flight
        self.trajectory: Trajectory | None = None
        self._now: Any = None
        self._shown: ShownCamera | None = None
        gui = server.gui
        self._newest: Any = gui.add_checkbox("Newest", grows, visible=grows)
        self._slider: Any = gui.add_slider("Seconds", 0.0, 1.0, 0.001, 0.0, visible=False)
        self._ride = gui.add_checkbox("Ride along", False)
        self._slider.on_update(self._slid)
        self._newest.on_update(lambda _: self._to_newest())
        self._ride.on_update(lambda event: self._move(event.client))

    def show(
        self, trajectory: Trajectory | None, depth: float, picture: UInt8Array | None = None
    ) -> None:
        """Draws what is new.

        Args:
            trajectory: that begins as the one before did.
            depth: length of the camera's frustum, map units.
            picture: what the newest camera saw; None: as before.
        """
        before, self.trajectory = self.trajectory, trajectory
        if trajectory is None:
            return
        self._draw_line(trajectory, 0 if before is None else len(before.times))
        if self._now is None:
            self._shown = _at(trajectory, 0)
            size = 1.5 * depth * self._unit
            self._now = add_frustum(self._server, "/now", self._shown, TRAJECTORY, self._unit, size)
        span = float(trajectory.times[-1] - trajectory.times[0])
        if span > 0 and (before is None or not np.array_equal(before.times, trajectory.times)):
            self._slider.max, self._slider.step = span, span / 1000.0
            self._slider.visible = True
        if self._newest.value:
            self._to_newest()
            if picture is not None:
                self._now.image = picture

    def _draw_line(self, trajectory: Trajectory, before: int) -> None:
        centres = (self._unit * trajectory.centres).astype(np.float32)
        lines = np.stack([centres[:-1], centres[1:]], axis=1)
        for begin in range(max(0, before - 1) // _PIECE * _PIECE, len(lines), _PIECE):
            self._server.scene.add_line_segments(
                f"/trajectory/{begin}",
                lines[begin : begin + _PIECE],
                TRAJECTORY,
                thickness=2.0,
                thickness_units="screen",
            )

    def _slid(self, event: Any) -> None:
        if event.client is None:
            return  # it was moved by what arrived
        self._newest.value = False
        trajectory = self.trajectory
        if trajectory is not None:
            time = float(trajectory.times[0]) + self._slider.value
            self._put(trajectory, trajectory.at(time), event.client)

    def _to_newest(self) -> None:
        trajectory = self.trajectory
        if trajectory is not None and self._newest.value:
            self._slider.value = float(trajectory.times[-1] - trajectory.times[0])
            self._put(trajectory, len(trajectory.times) - 1, None)

    def _put(self, trajectory: Trajectory, index: int, client: viser.ClientHandle | None) -> None:
        self._shown = _at(trajectory, index)
        pose = se3.inverse(self._shown.cam_from_map)
        quaternion, position = se3.to_quaternion_translation(pose)
        with self._server.atomic():
            self._now.wxyz, self._now.position = quaternion, self._unit * position
        if not self._newest.value:
            self._now.image = None  # it is of another moment
        self._move(client)

    def _move(self, client: viser.ClientHandle | None) -> None:
        """The eyes that ride along: of one browser, or of all."""
        if self._now is None or self._shown is None:
            return
        self._now.visible = not self._ride.value
        if self._ride.value:
            for each in self._server.get_clients().values() if client is None else (client,):
                self._flight.put(each, viewpoint_of(self._shown, each.camera.aspect))


def _at(trajectory: Trajectory, index: int) -> ShownCamera:
    return ShownCamera("final", "", trajectory.cam_from_map[index], trajectory.camera)
