# SPDX-License-Identifier: Apache-2.0
"""Plain threads that run compiled loops; the loops release Python's lock."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Callable, Iterable, Iterator

from gscpe.cores import available_cores
from gscpe.interrupts import interrupts_later


class KernelThreads:
    """Runs a kernel on all parts of its work, side by side.

    Args:
        threads: how many; None for as many as there are cores to use.
    """

    def __init__(self, threads: int | None = None) -> None:
        self.count = threads or available_cores()
        self._pool: ThreadPoolExecutor | None = None
        self._pool_owner = 0
        self._after_kernel: Callable[[], Any] | None = None

    def run(
        self, kernel: Callable[..., Any], parts: Iterable[tuple[int, ...]], *arguments: Any
    ) -> list[Any]:
        """Runs a kernel on all parts; its first arguments say which part."""
        if self.count == 1 or self._after_kernel is not None:
            results = [kernel(*part, *arguments) for part in parts]
            if self._after_kernel is not None:
                self._after_kernel()
            return results
        if self._pool is None or self._pool_owner != os.getpid():  # threads do not survive a fork
            self._pool = ThreadPoolExecutor(self.count, thread_name_prefix="gscpe-render")
            self._pool_owner = os.getpid()
        futures = [self._pool.submit(kernel, *part, *arguments) for part in parts]
        return [future.result() for future in futures]

    @contextmanager
    def compiling(self, after_kernel: Callable[[], Any]) -> Iterator[None]:
        """While kernels run for the first time, and so are compiled: one after the other, told
        of each, and Ctrl-C held back."""
        self._after_kernel = after_kernel
        with interrupts_later():
            yield
        self._after_kernel = None

    def close(self) -> None:
        """Ends the threads; running again would start new ones."""
        if self._pool is not None:
            self._pool.shutdown(wait=self._pool_owner == os.getpid())
            self._pool = None


def in_parts(count: int, size: int) -> list[tuple[int, int]]:
    """Ranges of ``size`` that make up ``count``. At least one, so that every kernel runs, and is
    compiled, whatever is in view."""
    return [(begin, min(begin + size, count)) for begin in range(0, count, size)] or [(0, 0)]
