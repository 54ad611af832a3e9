# SPDX-License-Identifier: Apache-2.0
"""NumPy's and SciPy's linear algebra on one thread, while poses are estimated.

The products of a pose estimate are small or thin. OpenBLAS spreads even these over all cores, and
its threads spin while they wait for each other: on 16 cores a photo took 1.6 times as long, and
nine times the processor time, as with one thread (docs/benchmarks.md). What pays to be done side by
side, we divide among threads of our own.
"""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import Any, Iterator

from threadpoolctl import ThreadpoolController


class _Limit:
    """The number of threads belongs to the process, and so does this: the first who asks sets it,
    and the last who leaves sets it back, whichever thread that is."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._holders = 0
        self._libraries: list[Any] | None = None
        self._before: list[int] = []

    def enter(self) -> None:
        with self._lock:
            if self._holders == 0:
                if self._libraries is None:  # to look for them takes 15 ms
                    found = ThreadpoolController().select(user_api="blas")
                    self._libraries = found.lib_controllers
                self._before = [library.num_threads for library in self._libraries]
                for library in self._libraries:
                    _set_threads(library, 1)
            self._holders += 1

    def leave(self) -> None:
        with self._lock:
            self._holders -= 1
            if self._holders == 0:
                for library, threads in zip(self._libraries or (), self._before, strict=True):
                    _set_threads(library, threads)


def _set_threads(library: Any, threads: int) -> None:
    """From any thread: since threadpoolctl 3.8, the thread that set it first keeps others out."""
    let_others = getattr(library, "clear_controlling_thread", lambda force: None)
    let_others(force=True)
    library.set_num_threads(threads)
    let_others(force=True)


_LIMIT = _Limit()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Linear algebra of the whole process uses one thread meanwhile, that of other threads, too.
    Any number of threads may be in it; it may be nested."""
    _LIMIT.enter()
    try:
        yield
    finally:
        _LIMIT.leave()
