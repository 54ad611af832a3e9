"""A worker in a process of its own: starting it, talking to it, and noticing that it died."""

from __future__ import annotations

import multiprocessing
import multiprocessing.resource_tracker
import signal
import threading
import traceback
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pickle import UnpicklingError
from typing import Iterator

from tqdm import tqdm

from gscpe.batch.details import Detail
from gscpe.batch.instructions import Instructions
from gscpe.batch.threads import limited_threads
from gscpe.batch.worker import Worker
from gscpe.errors import GscpeError
from gscpe.scene.query_list import Query

_PATIENCE = 5.0  # seconds that a process may take to end


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
