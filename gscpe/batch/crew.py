# SPDX-License-Identifier: Apache-2.0
"""What does the work: a crew takes queries and gives back details, in any order.

The smallest one is a worker in this process.
"""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Iterator, Sequence

from gscpe.batch.details import Detail
from gscpe.batch.fingerprint import Fingerprint
from gscpe.batch.worker import QueryWorker
from gscpe.closing import Closing
from gscpe.scene.query_list import Query


class Crew(Closing):
    """Localizes queries. Close it, or use it as a context manager.

    A photo that cannot be used, or that kills its workers, becomes a detail of the status
    ``failed``; other errors (no renderer, a damaged map) are raised, wherever they happened.

    Attributes:
        fingerprint: of map and settings; None where the map is no folder.
        image_folder: that the queries' names are relative to.
    """

    fingerprint: Fingerprint | None
    image_folder: Path

    @property
    @abstractmethod
    def description(self) -> str:
        """Who works, for people."""

    @abstractmethod
    def run(self, queries: Sequence[Query]) -> Iterator[tuple[Query, Detail]]:
        """Gives each query with its detail as soon as it is finished. One list at a time, to its
        end; after an interruption, close the crew.

        Raises:
            WorkerError: there are no workers any more.
            GscpeError: what a worker raised.
        """

    @abstractmethod
    def close(self) -> None:
        """Stops the work; what is not finished is dropped."""


class SerialCrew(Crew):
    """Implements :class:`gscpe.batch.Crew`; queries are finished in their order.

    Args:
        worker: is closed with the crew.
        fingerprint: of its map and settings, where they are known.
    """

    def __init__(self, worker: QueryWorker, fingerprint: Fingerprint | None = None) -> None:
        self.fingerprint = fingerprint
        self.image_folder = worker.image_folder
        self._worker = worker

    @property
    def description(self) -> str:
        return f"this process, {self._worker.description}"

    def run(self, queries: Sequence[Query]) -> Iterator[tuple[Query, Detail]]:
        for query in queries:
            yield query, self._worker.localize(query)

    def close(self) -> None:
        self._worker.close()
