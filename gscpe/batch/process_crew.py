# SPDX-License-Identifier: Apache-2.0
"""The crew of all cores: workers in processes, one renderer and some of the threads each.

A process is started, talked to through a pipe, and replaced when it dies.
"""

from __future__ import annotations

import contextlib
import logging
import math
import multiprocessing
import signal
import threading
import time
import traceback
from collections import Counter, deque
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pickle import UnpicklingError
from typing import Any, Iterator, Sequence

from tqdm import tqdm

from gscpe.batch.crew import Crew
from gscpe.batch.details import Detail, failed_details
from gscpe.batch.instructions import Instructions
from gscpe.batch.worker import Worker, limited_threads
from gscpe.cores import available_cores
from gscpe.errors import GscpeError, WorkerError, ran_out_of_memory
from gscpe.interrupts import born_without_interrupts, ignore_interrupts
from gscpe.scene.query_list import Query

_log = logging.getLogger(__name__)

_TRIES = 2
"""A query that kills so many workers has failed."""

_STILLBORN = 3
"""So many workers in a row that die before they are ready are enough."""

_PATIENCE = 5.0
"""Seconds that a process may take to end."""


class ProcessCrew(Crew):
    """Implements :class:`gscpe.batch.Crew` with processes started by ``spawn``.

    A worker that is killed costs nothing but time: another one takes its place, and the query
    is tried once more, at the end. One that does not answer is replaced too, and its query has
    failed. A script that uses this must begin its work under
    ``if __name__ == "__main__":``, since every worker imports the script.

    Args:
        instructions: for all workers; without threads, each has its share of the cores.
        workers: how many.

    Raises:
        WorkerError: they die when they start.
        MapError, RenderError, ...: what :meth:`gscpe.batch.Worker.start` raised in one of them.
    """

    def __init__(self, instructions: Instructions, workers: int) -> None:
        threads = instructions.threads or max(1, available_cores() // workers)
        self.fingerprint = instructions.fingerprint
        self.image_folder = instructions.image_folder
        self._instructions = replace(instructions, threads=threads)
        self._renderer = ""
        self._stillborn = 0
        self._workers: list[ProcessWorker] = []
        try:
            for _ in range(workers):
                self._hire()
            while not any(worker.ready for worker in self._workers):
                for worker, message in self._messages():
                    if message is None:
                        self._replace(worker)
        except BaseException:
            self.close()
            raise

    @property
    def description(self) -> str:
        return f"{len(self._workers)} processes, each: {self._renderer}"

    def at_work(self) -> dict[int, str]:
        """Process ids of the workers that are busy, and the photos that they work on."""
        return {each.pid: query.name for each in self._workers if (query := each.query)}

    def run(self, queries: Sequence[Query]) -> Iterator[tuple[Query, Detail]]:
        todo, deaths = deque(queries), Counter[str]()
        while True:
            self._hand_out(todo)
            if not todo and not any(worker.query for worker in self._workers):
                return
            for worker, message in self._messages():
                query, worker.query = worker.query, None
                if isinstance(message, dict):
                    assert query is not None
                    yield query, message
                elif message is None:
                    cause = self._replace(worker)
                    if query is None:
                        continue
                    deaths[query.name] += 1
                    again = deaths[query.name] < _TRIES and not worker.hung
                    _log.warning(
                        "a worker %s (%s) while localizing %s; the photo is %s",
                        "hung" if worker.hung else "died",
                        *(cause, query.name, "tried once more" if again else "given up"),
                    )
                    if again:
                        todo.append(query)
                        continue
                    reason = f"its worker died, {_TRIES} times ({cause})"
                    if worker.hung:
                        reason = f"its worker hung ({cause})"
                    yield query, failed_details(query, reason)

    def _hand_out(self, todo: deque[Query]) -> None:
        for worker in self._workers:
            if todo and worker.ready and worker.query is None and worker.give(todo[0]):
                todo.popleft()

    def _messages(self) -> list[tuple[ProcessWorker, Message | None]]:
        """Waits for at least one message, or death (None), or for a worker's time to be over,
        which ends it. Raises what a worker raised."""
        waiting: dict[Any, ProcessWorker] = {}
        for worker in self._workers:
            waiting |= {worker.pipe: worker, worker.sentinel: worker}
        messages: list[tuple[ProcessWorker, Message | None]] = []
        patience = min(worker.seconds_left() for worker in self._workers)
        found = wait(list(waiting), None if math.isinf(patience) else max(0.0, patience))
        for worker in dict.fromkeys(waiting[each] for each in found):
            message = worker.receive()
            if isinstance(message, Exception):
                raise message
            if isinstance(message, Ready):
                worker.ready, self._stillborn = True, 0
                self._renderer = message.description
            messages.append((worker, message))
        heard = [worker for worker, _ in messages]
        for worker in self._workers:
            if worker not in heard and worker.seconds_left() <= 0:
                worker.give_up()
                messages.append((worker, None))
        return messages

    def _hire(self) -> None:
        quiet = bool(self._renderer or self._workers)  # they would all say the same
        self._workers.append(ProcessWorker(self._instructions, quiet))

    def _replace(self, worker: ProcessWorker) -> str:
        """Another one for one that died; the cause of death."""
        self._workers.remove(worker)
        cause = worker.bury()
        if not worker.ready:
            self._stillborn += 1
        if self._stillborn < _STILLBORN:
            self._hire()
        elif self._workers:
            _log.warning("a worker died while starting (%s); continuing with fewer", cause)
        else:
            raise WorkerError(
                f"workers die while starting ({cause}); use fewer if memory is short; in a "
                "script, put the work under: if __name__ == '__main__':"
            )
        return cause

    def close(self) -> None:
        for worker in self._workers:
            worker.stop()
        self._workers.clear()


@dataclass(frozen=True)
class Ready:
    """The worker has opened the map."""

    description: str


Message = Ready | Detail | Exception
"""What comes from a worker. After an exception it has ended."""


class ProcessWorker:
    """A process with a :class:`gscpe.batch.Worker` in it.

    Attributes:
        ready: whether it has said so.
        query: that it works on.
        hung: it was ended because it gave no answer.
    """

    def __init__(self, instructions: Instructions, quiet: bool) -> None:
        context = multiprocessing.get_context("spawn")
        self.ready = False
        self.hung = False
        self.query: Query | None = None
        self._timeout = instructions.timeout
        self._since = time.monotonic()
        self.pipe, theirs = context.Pipe()
        self._process: SpawnProcess = context.Process(
            target=_work, args=(theirs, instructions, quiet), name="gscpe-worker", daemon=True
        )
        with limited_threads(instructions.threads), born_without_interrupts():
            self._process.start()
        theirs.close()  # so that theirs ends with the process

    @property
    def sentinel(self) -> int:
        """For multiprocessing.connection.wait: becomes ready when the process ends."""
        return self._process.sentinel

    @property
    def pid(self) -> int:
        """Of the process."""
        assert self._process.pid is not None
        return self._process.pid

    def give(self, query: Query) -> bool:
        """Has it work on a query; whether it was alive to take it."""
        try:
            self.pipe.send(query)
        except OSError:
            return False
        self.query = query
        self._since = time.monotonic()
        return True

    def seconds_left(self) -> float:
        """For what it does now; infinite where it is idle."""
        if self.ready and self.query is None:
            return math.inf
        return self._since + self._timeout - time.monotonic()

    def give_up(self) -> None:
        """Kills it, since its time is over."""
        self.hung = True
        self._process.kill()

    def receive(self) -> Message | None:
        """The next message, once the pipe or the sentinel is ready; None: the process died."""
        try:
            message: Message | None = self.pipe.recv() if self.pipe.poll() else None
        except (EOFError, OSError, UnpicklingError):  # the end, or it died while it was sending
            message = None
        return message

    def bury(self) -> str:
        """Waits for a process that died, and says what of."""
        self._process.join(_PATIENCE)
        self.stop()
        if self.hung:
            return f"no answer for {self._timeout:g} s"
        code = self._process.exitcode or 0
        if code >= 0:
            return f"exit status {code}"
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        return f"{name}; out of memory?" if name == "SIGKILL" else name

    def stop(self) -> None:
        """Ends it: an idle one by itself, a busy one at once."""
        self.pipe.close()
        if self.query is not None or not self.ready:
            self._process.kill()
        self._process.join(_PATIENCE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_PATIENCE)  # one that waits for a disk cannot even be killed


def _work(pipe: Connection, instructions: Instructions, quiet: bool) -> None:
    """What the process does, until the other end of the pipe is closed."""
    ignore_interrupts()
    if quiet:
        logging.getLogger("gscpe").setLevel(logging.ERROR)
    # A lock between processes, as tqdm makes one, is lost with a process that is killed.
    tqdm.set_lock(threading.RLock())
    try:
        with Worker.start(instructions) as worker:
            pipe.send(Ready(worker.description))
            while True:
                pipe.send(worker.localize(pipe.recv()))
    except (EOFError, ConnectionError):  # there is nobody to work for any more
        return
    except Exception as error:
        if ran_out_of_memory(error):  # its cause would not be sent
            error = MemoryError(str(error))
        elif not isinstance(error, GscpeError):  # a mistake of the program: show where
            error.add_note(traceback.format_exc())
        with contextlib.suppress(ConnectionError):
            pipe.send(_picklable(error))


def _picklable(error: Exception) -> Exception:
    from multiprocessing.reduction import ForkingPickler

    try:
        ForkingPickler.loads(ForkingPickler.dumps(error))
    except Exception:  # any error at all may come of foreign classes
        return RuntimeError("".join(traceback.format_exception(error)))
    return error
