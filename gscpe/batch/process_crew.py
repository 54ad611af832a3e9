# SPDX-License-Identifier: Apache-2.0
"""The crew of all cores: workers in processes, one renderer and some of the threads each."""

from __future__ import annotations

import functools
import logging
from collections import Counter, deque
from dataclasses import replace
from typing import Iterator, Sequence

from gscpe.batch.crew import Crew
from gscpe.batch.details import Detail, failed_details
from gscpe.batch.in_process import Answer
from gscpe.batch.instructions import Instructions
from gscpe.batch.processes import ProcessPool
from gscpe.batch.start import start_worker
from gscpe.cores import available_cores
from gscpe.scene.query_list import Query

_log = logging.getLogger(__name__)

_TRIES = 2
"""A query that kills so many workers has failed."""


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
        MapError, RenderError, ...: what :func:`gscpe.batch.start_worker` raised in one of them.
    """

    def __init__(self, instructions: Instructions, workers: int) -> None:
        threads = instructions.threads or max(1, available_cores() // workers)
        self.fingerprint = instructions.fingerprint
        self.image_folder = instructions.image_folder
        start = functools.partial(start_worker, replace(instructions, threads=threads))
        self._pool = ProcessPool(start, workers, threads, instructions.timeout)

    @property
    def description(self) -> str:
        return self._pool.described(len(self._pool.workers))

    def at_work(self) -> dict[int, str]:
        """Process ids of the workers that are busy, and the photos that they work on."""
        return {each.pid: query.name for each in self._pool.workers if (query := each.job)}

    def run(self, queries: Sequence[Query]) -> Iterator[tuple[Query, Detail]]:
        todo, deaths = deque(queries), Counter[str]()
        while True:
            self._hand_out(todo)
            if not todo and not any(worker.job for worker in self._pool.workers):
                return
            for worker, message in self._pool.messages():
                query: Query | None = worker.job
                worker.job = None
                if isinstance(message, Exception):
                    raise message
                if isinstance(message, Answer):
                    assert query is not None
                    yield query, message.content
                elif message is None:
                    cause = self._pool.replace(worker)
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
        for worker in self._pool.workers:
            if todo and worker.ready and worker.job is None and worker.give(todo[0]):
                todo.popleft()

    def close(self) -> None:
        self._pool.close()
