"""The crew of one: a worker in this process."""

from __future__ import annotations

from typing import Iterator, Sequence

from gscpe.batch.crew import Crew
from gscpe.batch.details import Detail
from gscpe.batch.fingerprint import Fingerprint
from gscpe.batch.worker import Worker
from gscpe.scene.query_list import Query


class SerialCrew(Crew):
    """Implements :class:`gscpe.batch.Crew`; queries are finished in their order.

    Args:
        worker: is closed with the crew.
        fingerprint: of its map and settings, where they are known.
    """

    def __init__(self, worker: Worker, fingerprint: Fingerprint | None = None) -> None:
        self.fingerprint = fingerprint
        self._worker = worker

    @property
    def description(self) -> str:
        return f"this process, {self._worker.description}"

    def run(self, queries: Sequence[Query]) -> Iterator[tuple[Query, Detail]]:
        for query in queries:
            yield query, self._worker.localize(query)

    def close(self) -> None:
        self._worker.close()
