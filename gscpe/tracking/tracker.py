# SPDX-License-Identifier: Apache-2.0
"""Follows a camera through a map, frame by frame."""

from __future__ import annotations

import threading
import time as clock
from pathlib import Path

import numpy as np

from gscpe.arrays import UInt8Array
from gscpe.blas import one_blas_thread
from gscpe.closing import Closing
from gscpe.errors import ClosedError, InputError, MapError, PoseError, SettingsError
from gscpe.geometry.camera import Camera
from gscpe.localization import Localizer
from gscpe.matching import Matcher
from gscpe.scene import Map
from gscpe.tracking.course import Course
from gscpe.tracking.frames import Frame, FrameMaker
from gscpe.tracking.motion import Motion
from gscpe.tracking.result import TrackingResult
from gscpe.tracking.search import NOT_LOOKED_FOR, Search
from gscpe.tracking.settings import TrackingSettings


class Tracker(Closing):
    """Follows one camera through a map: give it the frames in their order. Close it, or use it as a
    context manager, to end its threads.

    A frame is aligned with a render, the *anchor*, that serves for many frames; the next one is
    rendered in the background. Where the camera is not known, a :class:`gscpe.Localizer` looks for
    it in the background; its answer is carried forward to the current frame.

    Args:
        map_: to localize in, or the path of its folder; or a localizer, which is used, and not
            closed: trackers of one localizer share the memory of its map.
        settings: see :class:`gscpe.TrackingSettings`.
        backend, progress: as :class:`gscpe.Renderer`; not with a localizer.
        matcher: as :class:`gscpe.Localizer`; not with a localizer.

    Raises:
        SettingsError: settings of another type, or a matcher or a backend beside a localizer.
        MapError: the map has no references to recognize a place by.
        MapError, RenderError, ModelError, MissingDependencyError: as :class:`gscpe.Localizer`.
    """

    def __init__(
        self,
        map_: Localizer | Map | str | Path,
        settings: TrackingSettings | None = None,
        backend: str = "auto",
        matcher: Matcher | str | None = None,
        progress: bool = False,
    ) -> None:
        if not isinstance(settings, TrackingSettings | None):
            raise SettingsError(
                f"a Tracker's settings must be TrackingSettings, not a {type(settings).__name__}"
            )
        self.settings = settings or TrackingSettings()
        self._own: Localizer | None = None
        if isinstance(map_, Localizer):
            if backend != "auto" or matcher is not None:
                raise SettingsError(
                    "a tracker renders and matches as its localizer does: leave backend and "
                    "matcher out, or give the map in place of the localizer"
                )
            self.localizer = map_
        else:
            self.localizer = self._own = Localizer(
                map_, matcher=matcher, backend=backend, progress=progress
            )
        if not len(self.localizer.map.references):
            self._close_own()
            raise MapError(
                "this map has no reference photos to recognize a place by, so that a tracker "
                "would not find where to begin: build it with references"
            )
        self._frames = FrameMaker(self._scale_of, self.settings.levels)
        self._course = Course(self.localizer, self.settings)
        self._search = Search(self.localizer, self.settings)
        self._lock = threading.Lock()
        self._count = 0
        self._time: float | None = None
        self._timed: bool | None = None
        self._closed = False

    def track(
        self,
        image: UInt8Array,
        camera: Camera,
        time: float | None = None,
        motion: Motion | None = None,
    ) -> TrackingResult:
        """The next frame.

        Args:
            image: (H, W, 3) uint8 RGB, or grey, or with an opacity; as :meth:`Localizer.localize`
                takes it. It may be changed after.
            camera: its intrinsics.
            time: seconds, later than the last frame's, from any origin; for all frames or for
                none: then they are taken to follow each other at equal times.
            motion: of the camera since the last frame that was given, if it was measured.

        Raises:
            PhotoError, CameraError: as :meth:`Localizer.localize`; the frame does not count then.
            PoseError: the motion is no :class:`gscpe.Motion`.
            InputError: the time is not later than the last frame's, or one frame has a time and
                another has none.
            RenderError, ModelError: rendering or a trained network failed, perhaps in the
                background, for an earlier frame.
            ClosedError: the tracker or its localizer is closed.
        """
        with self._lock, one_blas_thread():
            begin = clock.perf_counter()
            if self._closed:
                raise ClosedError("this tracker is closed")
            if not isinstance(motion, Motion | None):
                raise PoseError(f"a motion must be a gscpe.Motion, not a {type(motion).__name__}")
            seconds = self._seconds(time)
            frame = self._frames.frame(image, camera, self._count, seconds, motion)
            self._count += 1
            self._time, self._timed = seconds, time is not None
            result = self._track(frame, image, camera)
            elapsed = 1000.0 * (clock.perf_counter() - begin)
            return result.within(elapsed)

    def _seconds(self, time: float | None) -> float:
        """The frame's time, or its number."""
        if self._timed is not None and self._timed != (time is not None):
            raise InputError("give a time with every frame, or with none")
        if time is None:
            return float(self._count)
        try:
            seconds = float(time)
        except (TypeError, ValueError):
            seconds = np.nan
        if not np.isfinite(seconds):
            raise InputError(f"a frame's time must be a finite number of seconds, not {time!r}")
        if self._time is not None and seconds <= self._time:
            raise InputError(
                f"frames must come in their order: {seconds:.6f} s is not later than the last "
                f"frame's {self._time:.6f} s"
            )
        return seconds

    def _scale_of(self, camera: Camera) -> float:
        return self.settings.scale * self.localizer.scale_to_the_map(camera)

    def _track(self, frame: Frame, image: UInt8Array, camera: Camera) -> TrackingResult:
        course, search = self._course, self._search
        found = search.found()
        if found is not None and not course.is_followed:
            course.begin(found)
        result = course.follow(frame, image, camera)
        if result.status != "lost":
            search.forget()
            return result
        trouble = frame.trouble()
        if self.settings.wait:
            if not course.wants_search or trouble is not None:
                return result
            if not search.is_due():
                return result.because(NOT_LOOKED_FOR)
            answer = search.at_once(frame, image, camera, course.state)
            if isinstance(answer, str):
                return result.because(answer)
            return course.begin_at(*answer, frame)
        if search.under_way:
            search.keep(frame)
        elif course.wants_search and trouble is None:
            search.begin(frame, image, camera, course.state)
        return result.because(search.last_reason)

    def close(self) -> None:
        """Ends the background threads, after what they do now is finished; the tracker cannot be
        used afterwards."""
        with self._lock:
            self._closed = True
            self._search.close()
            self._course.close()
            self._close_own()

    def _close_own(self) -> None:
        if self._own is not None:
            self._own.close()
