"""The crew of all cores: workers in processes, one renderer and some of the threads each.

A process is started, talked to through a pipe, and replaced when it dies.
"""

from __future__ import annotations

import logging
import multiprocessing
import multiprocessing.resource_tracker
import signal
import threading
import traceback
from collections import Counter, deque
from contextlib import contextmanager
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
from gscpe.errors import GscpeError, WorkerError
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
    is tried once more, at the end. A script that uses this must begin its work under
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
                    again = deaths[query.name] < _TRIES
                    _log.warning(
                        "a worker died (%s) at %s; it is %s",
                        *(cause, query.name, "tried once more" if again else "given up"),
                    )
                    if again:
                        todo.append(query)
                    else:
                        reason = f"its worker died, {_TRIES} times ({cause})"
                        yield query, failed_details(query, reason)

    def _hand_out(self, todo: deque[Query]) -> None:
        for worker in self._workers:
            if todo and worker.ready and worker.query is None and worker.give(todo[0]):
                todo.popleft()

    def _messages(self) -> list[tuple[ProcessWorker, Message | None]]:
        """Waits for at least one message, or death (None). Raises what a worker raised."""
        waiting: dict[Any, ProcessWorker] = {}
        for worker in self._workers:
            waiting |= {worker.pipe: worker, worker.sentinel: worker}
        messages: list[tuple[ProcessWorker, Message | None]] = []
        for worker in dict.fromkeys(waiting[each] for each in wait(list(waiting))):
            message = worker.receive()
            if isinstance(message, Exception):
                raise message
            if isinstance(message, Ready):
                worker.ready, self._stillborn = True, 0
                self._renderer = message.description
            messages.append((worker, message))
        return messages

    def _hire(self) -> None:
        self._workers.append(ProcessWorker(self._instructions))

    def _replace(self, worker: ProcessWorker) -> str:
        """Another one for one that died; the cause of death."""
        self._workers.remove(worker)
        cause = worker.bury()
        if not worker.ready:
            self._stillborn += 1
        if self._stillborn < _STILLBORN:
            self._hire()
        elif self._workers:
            _log.warning("a worker died when it started (%s); going on with fewer", cause)
        else:
            raise WorkerError(
                f"workers die when they start ({cause}); take fewer where memory is short, and "
                "begin a script's work under: if __name__ == '__main__':"
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
    """

    def __init__(self, instructions: Instructions) -> None:
        context = multiprocessing.get_context("spawn")
        self.ready = False
        self.query: Query | None = None
        self.pipe, theirs = context.Pipe()
        self._process: SpawnProcess = context.Process(
            target=_work, args=(theirs, instructions), name="gscpe-worker", daemon=True
        )
        with limited_threads(instructions.threads), _no_interrupts():
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
        return True

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
            self._process.kill()  # at SIGTERM, pycolmap prints where it was
        self._process.join(_PATIENCE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _work(pipe: Connection, instructions: Instructions) -> None:
    """What the process does, until the other end of the pipe is closed."""
    _ignore_interrupts()
    # A lock between processes, as tqdm makes one, is lost with a process that is killed.
    tqdm.set_lock(threading.RLock())
    try:
        with Worker.start(instructions) as worker:
            pipe.send(Ready(worker.description))
            while True:
                pipe.send(worker.localize(pipe.recv()))
    except (EOFError, BrokenPipeError):  # there is nobody to work for any more
        return
    except Exception as error:
        if not isinstance(error, GscpeError):  # a mistake of the program: show where
            error.add_note(traceback.format_exc())
        pipe.send(_picklable(error))


def _picklable(error: Exception) -> Exception:
    from multiprocessing.reduction import ForkingPickler

    try:
        ForkingPickler.loads(ForkingPickler.dumps(error))
    except Exception:  # any error at all may come of foreign classes
        return RuntimeError("".join(traceback.format_exception(error)))
    return error


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """A process that is started meanwhile has Ctrl-C blocked from its first moment; here, it is
    only delayed."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    multiprocessing.resource_tracker.ensure_running()  # or start() would, and unblock it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _ignore_interrupts() -> None:
    """Ctrl-C reaches every process of a terminal; the one that began the work ends the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
