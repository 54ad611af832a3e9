# SPDX-License-Identifier: Apache-2.0
"""Processes that hold something large and work with it: started, talked to through a pipe, and
replaced when they die or hang. Crews of batches and the service (gscpe.service) are made of them.
What happens in them, and what goes through the pipe, is in gscpe.batch.in_process.
"""

from __future__ import annotations

import contextlib
import logging
import math
import multiprocessing
import signal
import threading
import time
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pickle import UnpicklingError
from typing import Any, Sequence

from gscpe.batch.in_process import Message, Ready, Start, Stop, hold_and_work
from gscpe.batch.worker import limited_threads
from gscpe.closing import Closing
from gscpe.errors import WorkerError
from gscpe.interrupts import born_without_interrupts

_log = logging.getLogger(__name__)

_STILLBORN = 3
"""So many workers in a row that die before they are ready are enough."""

_PATIENCE = 5.0
"""Seconds that a process may take to end."""


class ProcessPool(Closing):
    """So many processes. A script that uses this must begin its work under
    ``if __name__ == "__main__":``, since every process imports the script.

    Args:
        start: what each of them holds.
        count: how many.
        threads: of each.
        timeout: seconds that one may take to start, and for a job.

    Raises:
        WorkerError: they die when they start.
        GscpeError: what ``start`` raised in one of them.

    Attributes:
        workers: that are alive, or were a moment ago.
        description: what renders.
    """

    def __init__(self, start: Start, count: int, threads: int | None, timeout: float) -> None:
        self._start, self._threads, self._timeout = start, threads, timeout
        self._stillborn = 0
        self.description = ""
        self.workers: list[ProcessWorker] = []
        try:
            for _ in range(count):
                self.hire()
            while not any(worker.ready for worker in self.workers):
                for worker, message in self.messages():
                    if isinstance(message, Exception):
                        raise message
                    if message is None:
                        self.replace(worker)
        except BaseException:
            self.close()
            raise

    def described(self, count: int) -> str:
        """So many of these processes, for people."""
        number = "1 process" if count == 1 else f"{count} processes, each"
        return f"{number}: {self.description}"

    def hire(self) -> None:
        """One more."""
        quiet = bool(self.description or self.workers)  # they would all say the same
        self.workers.append(ProcessWorker(self._start, self._threads, self._timeout, quiet))

    def messages(
        self, also: Sequence[Connection] = (), patience: float = math.inf
    ) -> list[tuple[ProcessWorker, Message | None]]:
        """Waits for a message, or death (None), or for a worker's time to be over, which ends it;
        or until one of the other connections has something, or the patience, seconds, ends."""
        waiting: dict[Any, ProcessWorker | None] = dict.fromkeys(also)
        for worker in self.workers:
            waiting |= {worker.pipe: worker, worker.sentinel: worker}
        patience = min([patience, *(worker.seconds_left() for worker in self.workers)])
        found = wait(list(waiting), None if math.isinf(patience) else max(0.0, patience))
        heard = dict.fromkeys(who for each in found if (who := waiting[each]) is not None)
        messages: list[tuple[ProcessWorker, Message | None]] = []
        for worker in heard:
            message = worker.receive()
            if isinstance(message, Ready):
                worker.ready, self._stillborn = True, 0
                self.description = message.description
            messages.append((worker, message))
        for worker in self.workers:
            if worker not in heard and worker.seconds_left() <= 0:
                worker.give_up()
                messages.append((worker, None))
        return messages

    def replace(self, worker: ProcessWorker) -> str:
        """Another one for one that died; the cause of death.

        Raises:
            WorkerError: they all die while starting.
        """
        self.workers.remove(worker)
        cause = worker.bury()
        if not worker.ready:
            self._stillborn += 1
        if self._stillborn < _STILLBORN:
            self.hire()
        elif self.workers:
            _log.warning("a worker died while starting (%s); continuing with fewer", cause)
        else:
            raise WorkerError(
                f"workers die while starting ({cause}); use fewer if memory is short; in a "
                "script, put the work under: if __name__ == '__main__':"
            )
        return cause

    def close(self) -> None:
        for worker in self.workers:
            worker.stop()
        self.workers.clear()


class ProcessWorker:
    """A process.

    Attributes:
        ready: whether it has said so.
        job: that it works on.
        hung: it was ended because it gave no answer.
    """

    def __init__(self, start: Start, threads: int | None, timeout: float, quiet: bool) -> None:
        context = multiprocessing.get_context("spawn")
        self.ready = False
        self.hung = False
        self.job: Any = None
        self._sender: threading.Thread | None = None
        self.timeout = timeout
        self._since = time.monotonic()
        self._seconds = timeout
        self.pipe, theirs = context.Pipe()
        self._process: SpawnProcess = context.Process(
            target=hold_and_work, args=(theirs, start, quiet), name="gscpe-worker", daemon=True
        )
        with limited_threads(threads), born_without_interrupts():
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

    def give(self, job: Any) -> bool:
        """Has it work on a job; whether it was alive to take it."""
        try:
            self.pipe.send(job)
        except OSError:
            return False
        self.job = job
        self.allow(self.timeout)
        return True

    def give_large(self, job: Any) -> None:
        """As :meth:`give`, of a job that does not fit into the pipe at once: a worker that hangs
        would not take it, so that a thread waits for that. Its death is noticed as any other."""
        self.job = job
        self.allow(self.timeout)
        self._sender = threading.Thread(target=self._send, args=(job,), daemon=True)
        self._sender.start()

    def _send(self, job: Any) -> None:
        with contextlib.suppress(OSError):
            self.pipe.send(job)

    def allow(self, seconds: float) -> None:
        """From now on, it may take so long for what it does."""
        self._since, self._seconds = time.monotonic(), seconds

    def seconds_left(self) -> float:
        """For what it does now; infinite where it is idle."""
        if self.ready and self.job is None:
            return math.inf
        return self._since + self._seconds - time.monotonic()

    def call_off(self, patience: float) -> None:
        """Asks it to stop; it is replaced where it does not within so many seconds."""
        if self._sender is None or not self._sender.is_alive():
            with contextlib.suppress(OSError):  # its end is noticed elsewhere
                self.pipe.send(Stop())
        self.allow(min(patience, max(0.0, self.seconds_left())))

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
            return f"no answer for {self._seconds:g} s"
        code = self._process.exitcode or 0
        if code >= 0:
            return f"exit status {code}"
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        return f"{name}; out of memory?" if name == "SIGKILL" else name

    def kill(self) -> None:
        """Ends it at once, whatever it does."""
        self._process.kill()
        self.stop()

    def stop(self) -> None:
        """Ends it: an idle one by itself, a busy one at once."""
        if self.job is not None or not self.ready:
            self._process.kill()
        if self._sender is not None:
            self._sender.join()  # nothing reads any more, or all was read
        self.pipe.close()
        self._process.join(_PATIENCE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_PATIENCE)  # one that waits for a disk cannot even be killed
