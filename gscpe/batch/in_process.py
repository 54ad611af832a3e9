# SPDX-License-Identifier: Apache-2.0
"""The inside of a process of gscpe.batch.processes: what it holds, the messages between it and
whoever started it, and its loop of jobs and answers."""

from __future__ import annotations

import contextlib
import logging
import threading
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Callable, Protocol

from tqdm import tqdm

from gscpe.errors import GscpeError, ran_out_of_memory
from gscpe.interrupts import ignore_interrupts


class Works(Protocol):
    """What a process holds: made once, then given one job after the other."""

    @property
    def description(self) -> str:
        """What renders, for people."""

    def work(self, job: Any, talk: Talk) -> Any:
        """The answer to a job; both can be pickled. Errors end the process."""

    def close(self) -> None:
        """Gives back what it holds."""


Start = Callable[[], Works]
"""Makes one, in the process; it can be pickled."""


@dataclass(frozen=True)
class Ready:
    """The worker has opened what it needs."""

    description: str


@dataclass(frozen=True)
class Told:
    """What a worker says while it works."""

    news: Any


@dataclass(frozen=True)
class Answer:
    """Of a job."""

    content: Any


@dataclass(frozen=True)
class Stop:
    """To a worker: nobody waits for the answer any more."""


class StoppedError(Exception):
    """Raised in a worker where it looks whether it is to stop, and is."""


Message = Ready | Told | Answer | Exception
"""What comes from a worker. After an exception it has ended."""


class Talk:
    """A worker's connection to whoever gave it a job, while it works."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe

    def tell(self, news: Any) -> None:
        """Says something before the answer."""
        self._pipe.send(Told(news))

    def stop_if_told(self) -> None:
        """To be called now and then.

        Raises:
            StoppedError: the job was called off.
            EOFError: there is nobody to work for any more.
        """
        if self._pipe.poll() and isinstance(self._pipe.recv(), Stop):
            raise StoppedError


def hold_and_work(pipe: Connection, start: Start, quiet: bool) -> None:
    """What the process does, until the other end of the pipe is closed.

    Args:
        pipe: jobs come from it, and :data:`Message` goes into it.
        start: makes what is held.
        quiet: only errors are logged.
    """
    ignore_interrupts()
    if quiet:
        logging.getLogger("gscpe").setLevel(logging.ERROR)
    # A lock between processes, as tqdm makes one, is lost with a process that is killed.
    tqdm.set_lock(threading.RLock())
    try:
        with contextlib.closing(start()) as worker:
            pipe.send(Ready(worker.description))
            while True:
                job = pipe.recv()
                if isinstance(job, Stop):  # it came too late
                    continue
                try:
                    answer = worker.work(job, Talk(pipe))
                except StoppedError:
                    answer = None
                pipe.send(Answer(answer))
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
