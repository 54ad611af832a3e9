# SPDX-License-Identifier: Apache-2.0
"""The processes of a service: jobs from any thread, an answer to each. One that dies or hangs is
replaced, and its job is tried once more."""

from __future__ import annotations

import contextlib
import logging
import math
import multiprocessing
import threading
import time
from collections import deque
from concurrent.futures import Future, InvalidStateError
from typing import Any

from gscpe.batch.in_process import Answer, Message, Start, Told
from gscpe.batch.instructions import TIMEOUT
from gscpe.batch.processes import ProcessPool, ProcessWorker
from gscpe.closing import Closing
from gscpe.errors import GscpeError, WorkerError
from gscpe.service.desk import DECODING, Job, LocalizeJob
from gscpe.service.limits import Limits
from gscpe.service.metrics import Metrics
from gscpe.service.problem import Problem, busy, too_slow

_log = logging.getLogger(__name__)

_TRIES = 2

_GRACE = 10.0
"""Seconds in which a worker may notice that its job was called off."""

_REST = 10.0
"""Seconds until workers are started anew, after all of them died while starting."""


class Ticket:
    """A job that was given.

    Attributes:
        future: of its answer; a Problem is an answer too.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self.future: Future[Any] = Future()
        self.tries = 0
        self.decoding = False
        self.called_off = False

    def answer(self, content: Any) -> None:
        """To whoever waits, if somebody does."""
        with contextlib.suppress(InvalidStateError):
            self.future.set_result(content)


class Staff(Closing):
    """Starts the processes, and a thread that looks after them.

    Args:
        start: what each process holds.
        workers: how many.
        threads: of each.
        limits: how long a job may take.
        metrics: where it counts who was replaced.

    Raises:
        WorkerError: they die when they start.
        GscpeError: what ``start`` raised in one of them.
    """

    def __init__(
        self, start: Start, workers: int, threads: int, limits: Limits, metrics: Metrics
    ) -> None:
        self._limits, self._metrics, self._count = limits, metrics, workers
        # To start, a worker may take as long as one of a batch: a map may be large.
        self._pool = ProcessPool(start, workers, threads, max(TIMEOUT, limits.seconds))
        self.description = self._pool.described(workers)
        self._lock = threading.Lock()
        self._waiting: deque[Ticket] = deque()
        self._called_off: list[Ticket] = []
        self._at_work: dict[ProcessWorker, Ticket] = {}
        self._last_map: dict[ProcessWorker, str] = {}
        self._rests_until: float | None = None
        self._closing = False
        self._bell, self._ring = multiprocessing.Pipe(duplex=False)
        self._rung = False
        self._thread = threading.Thread(target=self._run, name="gscpe-staff", daemon=True)
        self._thread.start()

    def submit(self, job: Job) -> Ticket:
        """Has a job done, after those before."""
        ticket = Ticket(job)
        with self._lock:
            if self._closing:
                ticket.answer(busy("the service ends", math.ceil(_REST)))
                return ticket
            self._waiting.append(ticket)
        self._wake()
        return ticket

    def call_off(self, ticket: Ticket) -> None:
        """Nobody waits for the answer any more: a job that waits is dropped, and one that is
        worked on is stopped."""
        with self._lock:
            ticket.called_off = True
            ticket.future.cancel()
            if ticket in self._waiting:
                self._waiting.remove(ticket)
            else:
                self._called_off.append(ticket)
        self._wake()

    @property
    def waiting(self) -> int:
        """Jobs that no process has begun."""
        return len(self._waiting)

    @property
    def busy(self) -> int:
        """Processes that work."""
        return len(self._at_work)

    @property
    def alive(self) -> int:
        """Processes that are ready, working or not."""
        return sum(worker.ready for worker in list(self._pool.workers))

    def pids(self) -> dict[int, str | None]:
        """Process ids, and the names of the photos that they work on."""
        at_work = {worker.pid: ticket.job for worker, ticket in list(self._at_work.items())}
        return {
            worker.pid: getattr(at_work.get(worker.pid), "name", None)
            for worker in list(self._pool.workers)
        }

    def close(self) -> None:
        """Ends the processes at once; who still waits is told so."""
        with self._lock:
            self._closing = True
        self._wake()
        self._thread.join()
        for ticket in (*self._waiting, *self._at_work.values()):
            ticket.answer(busy("the service ends", math.ceil(_REST)))
        self._pool.close()
        self._bell.close()
        self._ring.close()

    def _wake(self) -> None:
        with self._lock:
            if not self._rung and not self._ring.closed:
                self._rung = True
                self._ring.send_bytes(b".")

    def _run(self) -> None:
        while not self._closing:
            try:
                self._turn()
            except Exception:  # whatever it was, those who wait must not wait for ever
                _log.exception("the staff's thread failed; it goes on")
                time.sleep(0.1)

    def _turn(self) -> None:
        self._fill_up()
        self._hand_out()
        rest = math.inf if self._rests_until is None else self._rests_until - time.monotonic()
        for worker, message in self._pool.messages([self._bell], max(0.0, rest)):
            self._hear(worker, message)
        with self._lock:
            if self._rung:
                self._bell.recv_bytes()
                self._rung = False
            called_off, self._called_off = self._called_off, []
        for worker, ticket in self._at_work.items():
            if ticket in called_off:
                worker.call_off(_GRACE)

    def _hand_out(self) -> None:
        for worker in self._pool.workers:
            if not worker.ready or worker in self._at_work:
                continue
            with self._lock:
                if not self._waiting:
                    return
                ticket = self._chosen(worker)
                self._waiting.remove(ticket)
                self._at_work[worker] = ticket
            ticket.tries += 1
            worker.give_large(ticket.job)
            self._last_map[worker] = ticket.job.map
            worker.allow(self._limits.seconds)
            if isinstance(ticket.job, LocalizeJob):  # which is told as soon as it is taken
                worker.allow(min(self._limits.seconds, self._limits.decode_seconds))

    def _chosen(self, worker: ProcessWorker) -> Ticket:
        """The first one, or one of the next few for the map that this worker has open."""
        last = self._last_map.get(worker)
        near = (ticket for ticket in list(self._waiting)[:4] if ticket.job.map == last)
        first = self._waiting[0]
        if first.tries or len(self._pool.workers) == 1:
            return first
        return next(near, first)

    def _hear(self, worker: ProcessWorker, message: Message | None) -> None:
        ticket = self._at_work.get(worker)
        if isinstance(message, Told):
            if ticket is not None:
                self._told(worker, ticket, message.news)
        elif isinstance(message, Answer):
            worker.job = None
            with self._lock:
                del self._at_work[worker]
            if ticket is not None:
                ticket.answer(message.content)
        elif message is None or isinstance(message, Exception):
            with self._lock:
                self._at_work.pop(worker, None)
            self._last_map.pop(worker, None)
            self._bury(worker, ticket, message)

    def _told(self, worker: ProcessWorker, ticket: Ticket, news: Any) -> None:
        ticket.decoding = news == DECODING
        seconds = self._limits.decode_seconds if ticket.decoding else self._limits.seconds
        worker.allow(min(seconds, _GRACE) if ticket.called_off else seconds)

    def _bury(self, worker: ProcessWorker, ticket: Ticket | None, error: Exception | None) -> None:
        hung = worker.hung
        try:
            cause = self._pool.replace(worker)
        except WorkerError as refusal:
            cause = str(refusal)
            self._send_away()
        cause = cause if error is None else f"{type(error).__name__}: {error}"
        self._metrics.replaced += 1
        _log.warning("a worker %s (%s) and is replaced", "hung" if hung else "died", cause)
        if isinstance(error, Exception) and not isinstance(error, GscpeError):
            _log.error("its error: %s", "\n".join([repr(error), *getattr(error, "__notes__", ())]))
        if ticket is None or ticket.called_off:
            return
        if hung and ticket.decoding:
            ticket.answer(_never_decoded(ticket.job, self._limits))
        elif ticket.tries < _TRIES:
            ticket.decoding = False
            with self._lock:
                self._waiting.appendleft(ticket)
        else:
            ticket.answer(_given_up(hung, self._limits))

    def _send_away(self) -> None:
        """All workers die while starting: who waits is told."""
        with self._lock:
            waiting = list(self._waiting)
            self._waiting.clear()
        for ticket in waiting:
            ticket.answer(_no_workers())

    def _fill_up(self) -> None:
        """Workers that died while starting are started again after a rest."""
        missing = self._count - len(self._pool.workers)
        if missing <= 0:
            self._rests_until = None
        elif self._rests_until is None:
            self._rests_until = time.monotonic() + _REST
        elif time.monotonic() >= self._rests_until:
            self._rests_until = None
            for _ in range(missing):
                self._pool.hire()


def _never_decoded(job: Job, limits: Limits) -> Problem:
    name = getattr(job, "name", "the photo")
    return too_slow(f"{name} takes more than {limits.decode_seconds:g} s to decode; shrink it", 422)


def _no_workers() -> Problem:
    return busy("the workers are being started", math.ceil(_REST))


def _given_up(hung: bool, limits: Limits) -> Problem:
    if hung:
        return too_slow(
            f"its worker hung, {_TRIES} times (no answer for {limits.seconds:g} s)", 504
        )
    return Problem(500, "WorkerError", f"its worker died, {_TRIES} times")
