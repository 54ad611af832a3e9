"""What does the work: a crew takes queries and gives back details, in any order."""

from __future__ import annotations

from types import TracebackType
from typing import Iterator, Protocol, Self, Sequence

from gscpe.batch.details import Detail
from gscpe.batch.fingerprint import Fingerprint
from gscpe.scene.query_list import Query


class Crew(Protocol):
    """Localizes queries. Close it, or use it as a context manager.

    A photo that cannot be used, or that kills its workers, becomes a detail of the status
    ``failed``; other errors (no renderer, a damaged map) are raised, wherever they happened.
    """

    @property
    def fingerprint(self) -> Fingerprint | None:
        """Of map and settings; None where the map is no folder."""
        ...

    @property
    def description(self) -> str:
        """Who works, for people."""
        ...

    def run(self, queries: Sequence[Query]) -> Iterator[tuple[Query, Detail]]:
        """Gives each query with its detail as soon as it is finished. One list at a time, to its
        end; after an interruption, close the crew.

        Raises:
            WorkerError: there are no workers any more.
            GscpeError: what a worker raised.
        """
        ...

    def close(self) -> None:
        """Stops the work; what is not finished is dropped."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...
