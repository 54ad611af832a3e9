# SPDX-License-Identifier: Apache-2.0
"""Cameras that are followed: a process with a tracker for each connection. Frames that come while
it works are lost, but for the newest, so that a slow one does not fall behind."""

from __future__ import annotations

import asyncio
import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, TypeVar

from gscpe.batch.in_process import Answer, Ready, Talk
from gscpe.batch.instructions import TIMEOUT
from gscpe.batch.one_photo import OnePhoto
from gscpe.batch.processes import ProcessWorker
from gscpe.batch.shelf import Shelf, ShelfOrder
from gscpe.closing import Closing
from gscpe.errors import InputError
from gscpe.geometry.camera import Camera
from gscpe.poses.hloc import format_pose
from gscpe.service.limits import Limits, check_photo
from gscpe.service.problem import ProblemError, problem_of
from gscpe.tracking import Tracker, TrackingResult

_T = TypeVar("_T")

_LIVES = 2
"""Trackers that may die in one connection."""


@dataclass(frozen=True, eq=False)
class FrameJob:
    """A frame: its number, the bytes of a file, and its time in seconds."""

    number: int
    photo: bytes
    time: float


class TrackerDesk(Closing):
    """Follows one camera; see :class:`gscpe.batch.in_process.Works`."""

    def __init__(self, shelf: Shelf, map_: str, camera: Camera, limits: Limits) -> None:
        self._shelf, self._camera, self._limits = shelf, camera, limits
        self._tracker = Tracker(shelf.localizer(map_))
        self.description = "a tracker"

    @classmethod
    def start(cls, order: ShelfOrder, map_: str, camera: Camera, limits: Limits) -> TrackerDesk:
        """Opens the map.

        Raises:
            GscpeError: as :class:`gscpe.Tracker`.
        """
        return cls(Shelf(order), map_, camera, limits)

    def work(self, job: FrameJob, talk: Talk) -> dict[str, Any]:
        """What is known of a frame; one that cannot be used has the status ``failed``."""
        name = f"frame {job.number}"
        try:
            check_photo(job.photo, name, self._limits)
            image = OnePhoto.decode(job.photo, name, self._camera).image
            return frame_json(job.number, self._tracker.track(image, self._camera, job.time))
        except (InputError, ProblemError) as error:
            reason = problem_of(error).detail
            return {"frame": job.number, "status": "failed", "reason": reason}

    def close(self) -> None:
        self._tracker.close()
        self._shelf.close()


def frame_json(number: int, result: TrackingResult) -> dict[str, Any]:
    """A frame's result as plain data."""
    pose, covariance, agreement = result.cam_from_world, result.covariance, result.agreement
    return {
        "frame": number,
        "status": result.status,
        "reason": result.reason,
        "cam_from_world": None if pose is None else format_pose(pose),
        "matrix": None if pose is None else pose.tolist(),
        "covariance": None if covariance is None else covariance.tolist(),
        "agreement": round(agreement, 4) if math.isfinite(agreement) else None,
        "milliseconds": round(result.milliseconds, 3),
    }


class TrackerProcess:
    """The process of one connection, seen from the server; another one begins where it dies.

    Args:
        order, map_, camera, limits: of the desk.
        threads: of the process.
    """

    def __init__(
        self, order: ShelfOrder, map_: str, camera: Camera, limits: Limits, threads: int
    ) -> None:
        self._start = partial(TrackerDesk.start, order, map_, camera, limits)
        self._limits, self._threads = limits, threads
        self._worker: ProcessWorker | None = None
        self._lives = _LIVES
        # Of its own: many that wait would leave no thread of asyncio's to others.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="gscpe-tracker")

    async def ask(self, job: FrameJob) -> dict[str, Any]:
        """What is known of a frame.

        Raises:
            ConnectionError: the trackers die.
        """
        return await self._in_thread(partial(self._ask, job))

    async def open(self) -> None:
        """Starts it.

        Raises:
            ConnectionError: it does not start.
        """
        await self._in_thread(self._opened)

    async def end(self) -> None:
        """Ends it, whatever it does."""
        await asyncio.to_thread(self.close)
        self._thread.shutdown(wait=False)

    async def _in_thread(self, work: Callable[[], _T]) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def _opened(self) -> ProcessWorker:
        if self._worker is None:
            if not self._lives:
                raise ConnectionError("the tracker died too often")
            self._lives -= 1
            seconds = self._limits.seconds
            self._worker = ProcessWorker(self._start, self._threads, max(TIMEOUT, seconds), True)
            if not isinstance(self._next(), Ready):
                self.close()
                raise ConnectionError("the tracker does not start")
            self._worker.timeout = seconds
        return self._worker

    def _ask(self, job: FrameJob) -> dict[str, Any]:
        worker = self._opened()
        worker.give_large(job)
        answer = self._next()
        worker.job = None
        if isinstance(answer, Answer):
            content: dict[str, Any] = answer.content
            return content
        self.close()  # the next frame begins anew
        return {"frame": job.number, "status": "lost", "reason": "its worker died or hung"}

    def _next(self) -> Any:
        """What it says; None where it died or hung."""
        worker = self._worker
        assert worker is not None
        try:
            if not worker.pipe.poll(max(0.0, worker.seconds_left())):
                worker.give_up()
                return None
        except OSError:  # closed, since the connection ended
            return None
        message = worker.receive()
        worker.ready = worker.ready or isinstance(message, Ready)
        return message

    def close(self) -> None:
        """Ends it at once."""
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.kill()


class LatestFrame:
    """Between who receives frames and who works on them: only the newest is kept."""

    def __init__(self) -> None:
        self._frame: FrameJob | None = None
        self._there = asyncio.Event()
        self._over = False
        self.lost = 0

    def put(self, frame: FrameJob) -> None:
        """A frame; one that nobody has taken yet is lost."""
        self.lost += self._frame is not None
        self._frame = frame
        self._there.set()

    def end(self) -> None:
        """There are no more."""
        self._over = True
        self._there.set()

    async def take(self) -> FrameJob | None:
        """The newest frame, once there is one that was not taken; None at the end."""
        await self._there.wait()
        frame, self._frame = self._frame, None
        if not self._over:
            self._there.clear()
        return frame


class FrameTimes:
    """Times of frames: those that were sent, or when they came; always rising."""

    def __init__(self) -> None:
        self._begin = time.monotonic()
        self._sent: bool | None = None
        self._last = -math.inf

    def time_of(self, sent: float | None) -> float:
        """Seconds of the next frame.

        Raises:
            InputError: it is not later than the last one, or some frames have a time and others
                have none.
        """
        if self._sent is not None and self._sent != (sent is not None):
            raise InputError("give a time with every frame, or with none")
        seconds = time.monotonic() - self._begin if sent is None else sent
        if not math.isfinite(seconds):
            raise InputError("a frame's time must be a finite number of seconds")
        if sent is not None and seconds <= self._last:
            raise InputError(f"frames must come in their order: {seconds:.6f} s is not later")
        self._sent, self._last = sent is not None, max(seconds, self._last + 1e-6)
        return self._last
