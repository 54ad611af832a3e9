# SPDX-License-Identifier: Apache-2.0
"""What is done beside the frames: one thread renders anchors, one localizes and checks."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Callable, Generic, TypeVar

from gscpe.blas import one_blas_thread

_T = TypeVar("_T")


class Errand(Generic[_T]):
    """Something that is done in another thread, one at a time."""

    def __init__(self, name: str) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._future: Future[_T] | None = None

    @property
    def under_way(self) -> bool:
        """Whether its answer has not been fetched yet."""
        return self._future is not None

    def begin(self, work: Callable[[], _T]) -> None:
        assert self._future is None
        self._future = self._pool.submit(_on_one_blas_thread, work)

    def fetch(self, patience: float | None = 0.0) -> tuple[_T] | None:
        """What came of it, once; None where nothing is there after so many seconds (None: waits
        until it is). Raises what it raised."""
        future = self._future
        if future is None:
            return None
        if patience != 0.0:
            wait([future], timeout=patience)
        if not future.done():
            return None
        self._future = None
        return (future.result(),)

    def forget(self) -> None:
        """Its answer is not wanted any more; what has begun is done to its end."""
        if self._future is not None:
            self._future.cancel()
            self._future = None

    def close(self) -> None:
        """Waits for what has begun, and ends the thread."""
        self._pool.shutdown(wait=True, cancel_futures=True)


def _on_one_blas_thread(work: Callable[[], _T]) -> _T:
    with one_blas_thread():
        return work()
