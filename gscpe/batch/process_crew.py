"""The crew of all cores: workers in processes, one renderer and some of the threads each."""

from __future__ import annotations

import logging
from collections import Counter, deque
from dataclasses import replace
from multiprocessing.connection import wait
from typing import Any, Iterator, Sequence

from gscpe.batch.crew import Crew
from gscpe.batch.details import Detail, failed_details
from gscpe.batch.instructions import Instructions
from gscpe.batch.process_worker import Message, ProcessWorker, Ready
from gscpe.cores import available_cores
from gscpe.errors import WorkerError
from gscpe.scene.query_list import Query

_log = logging.getLogger(__name__)

_TRIES = 2
"""A query that kills so many workers has failed."""

_STILLBORN = 3
"""So many workers in a row that die before they are ready are enough."""


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
