# SPDX-License-Identifier: Apache-2.0
"""The splat in the browser, and the sliders that cut it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.viewer.splat import BrowserSplat, Section, scaled_covariances

if TYPE_CHECKING:
    import viser

_SIDES = ("Across", "Along", "Height")


class CutSplat:
    """The Gaussians inside of a section.

    Args:
        server: of the page.
        splat: that is drawn.
        unit: browser units in a map unit.
        axes: (3, 3), rows: across, along and up.

    Attributes:
        node: of the splat.
        section: what is shown now.
        sliders: one for each axis, once :meth:`add_sliders` was called.
    """

    def __init__(
        self, server: viser.ViserServer, splat: BrowserSplat, unit: float, axes: Float64Array
    ) -> None:
        self._server = server
        self._means = splat.means
        self._lock = threading.Lock()
        self.node: Any = server.scene.add_gaussian_splats(
            "/splat",
            centers=splat.means * np.float32(unit),
            covariances=scaled_covariances(splat, unit),
            rgbs=splat.colours,
            opacities=splat.opacities,
        )
        self._buffer = self.node.buffer
        self.section = Section.around(splat.means, axes)
        self.sliders: list[Any] = []

    def add_sliders(self) -> None:
        """Where the panel is being filled."""
        low, high = self.section.limits
        for name, begin, end in zip(_SIDES, low.tolist(), high.tolist(), strict=True):
            step = (end - begin) / 200.0
            slider = self._server.gui.add_multi_slider(name, begin, end, step, (begin, end))
            slider.on_update(lambda _: self.cut())
            self.sliders.append(slider)

    def cut(self) -> None:
        """Shows what lies inside of the sliders' ends."""
        with self._lock:  # of many events while dragging, the last one counts
            old = self.section
            ends = np.array([slider.value for slider in self.sliders])
            if np.array_equal(ends.T, [old.low, old.high]):
                return
            self.section = Section(old.axes, ends[:, 0], ends[:, 1], old.limits)
            inside = self.section.inside(self._means)
            if not np.any(inside):
                inside[:1] = True  # viser needs one
            self.node.buffer = self._buffer[inside]
