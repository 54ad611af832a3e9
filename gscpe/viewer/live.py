# SPDX-License-Identifier: Apache-2.0
"""The page while photos are localized or a camera is followed: it shows what arrives."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any, Mapping, Sequence

import cv2
import numpy as np

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.closing import Closing
from gscpe.geometry.camera import Camera
from gscpe.scene import Map
from gscpe.sequences import Frame
from gscpe.tracking import TrackingResult
from gscpe.viewer.contents import Findings, contents_of
from gscpe.viewer.page import Viewer

_SECONDS = 0.5
"""Between two drawings at least."""

_SHARE = 10.0
"""Times as long as a drawing took are left to the work, at least."""

_WIDTH = 160  # pixels of the newest frame


class Live(Closing):
    """A page that grows. A thread of its own draws, so that the work need not wait.

    Args:
        map_: that is worked with.
        photo_folders: where photos are found by name.
        page: what else :class:`Viewer` takes.

    Raises:
        GscpeError: as :class:`Viewer`.

    Attributes:
        viewer: the page.
    """

    def __init__(self, map_: Map, photo_folders: Sequence[str | Path] = (), **page: Any) -> None:
        self._map = map_
        self._base = contents_of(map_)
        self._details: dict[str, Mapping[str, Any]] = {}
        self._trajectory: dict[float, Float64Array] = {}
        self._lost: dict[str, str] = {}
        self._camera: Camera | None = None
        self._picture: UInt8Array | None = None
        self._news = "Waiting for what is found."
        self._lock = threading.Lock()
        self._something = threading.Event()
        self._over = threading.Event()
        self._finished = False
        self.viewer = Viewer(map_, self._base, photo_folders, grows=True, **page)
        self.viewer.say(self._news)
        self._thread = threading.Thread(target=self._draw_what_comes, daemon=True)
        self._thread.start()

    def add_detail(self, detail: Mapping[str, Any]) -> None:
        """A photo that was looked at.

        Args:
            detail: as ``gscpe localize`` writes it (docs/formats.md).
        """
        with self._lock:
            self._details[str(detail["name"])] = detail
            found = sum(each["status"] == "localized" for each in self._details.values())
            self._news = f"{found} of {len(self._details)} photos localized so far."
        self._something.set()

    def add(self, frame: Frame, result: TrackingResult | None) -> None:
        """A frame of a camera that is followed; see :class:`gscpe.following.Observes`."""
        with self._lock:
            if result is not None and result.cam_from_world is not None:
                self._trajectory[float(frame.stamp)] = result.cam_from_world
                self._camera, self._picture = frame.camera, frame.image
                status = str(result.status)
            else:
                reason = (frame.trouble if result is None else result.reason) or "not known why"
                self._lost[frame.name] = reason
                status = f"lost: {reason}"
            self._news = f"{frame.name}: {status}. {len(self._trajectory)} poses so far."
        self._something.set()

    def finish(self) -> None:
        """No more will come: everything is drawn now, and the page says so."""
        self._finished = True
        self._end()

    def close(self) -> None:
        self._end()
        self.viewer.close()

    def _end(self) -> None:
        self._over.set()
        self._something.set()
        self._thread.join()

    def _draw_what_comes(self) -> None:
        while not self._over.is_set():
            self._something.wait()
            self._something.clear()
            begin = time.perf_counter()
            self._draw()
            took = time.perf_counter() - begin
            self._over.wait(max(_SECONDS, _SHARE * took))
        if not self._finished:
            return
        self._draw()
        self.viewer.say(f"Finished. {self._news.replace(' so far', '')}")

    def _draw(self) -> None:
        with self._lock:
            findings = Findings(
                details=dict(self._details),
                trajectory=dict(self._trajectory),
                lost=dict(self._lost),
                walking=self._camera,
            )
            picture, news = self._picture, self._news
        contents = contents_of(self._map, findings, like=self._base)
        self.viewer.show(contents, None if picture is None else _small(picture))
        self.viewer.say(news)


def _small(image: UInt8Array) -> UInt8Array:
    height, width = image.shape[:2]
    size = _WIDTH, max(1, round(_WIDTH * height / width))
    return np.asarray(cv2.resize(image[:, :, :3], size, interpolation=cv2.INTER_AREA), np.uint8)
