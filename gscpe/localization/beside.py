# SPDX-License-Identifier: Apache-2.0
"""A second thread, for what need not wait: features while retrieval runs, matches while images are
aligned. Each of these leaves a core idle for part of its time."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Callable, Generic, TypeVar

from gscpe.cores import available_cores
from gscpe.matching import LighterGlueMatcher, Matcher, OnnxMatcher, SiftMatcher, XFeatMatcher

_T = TypeVar("_T")

_SAFE = (XFeatMatcher, LighterGlueMatcher, SiftMatcher, OnnxMatcher)
"""Matchers that may be called by two threads at a time."""


class Work(Generic[_T]):
    """What was given to a :class:`Beside`."""

    def __init__(self, work: Callable[[], _T], future: Future[_T] | None) -> None:
        self._work = work
        self._future = future

    def result(self) -> _T:
        """Waits for it; where there is no second thread, does it now. Raises what it raises."""
        if self._future is None:
            self._future = Future()
            self._future.set_result(self._work())
        return self._future.result()

    def drop(self) -> None:
        """It is not needed; what has been begun is finished."""
        if self._future is not None:
            self._future.cancel()


class Beside:
    """Does work in a thread of its own, in order; or where a thread does not pay, when its result
    is asked for."""

    def __init__(self, matcher: Matcher) -> None:
        self._threads = isinstance(matcher, _SAFE) and available_cores() > 1
        self._lock = threading.Lock()
        self._pool: ThreadPoolExecutor | None = None

    def begin(self, work: Callable[[], _T]) -> Work[_T]:
        """Begins soon, while the caller goes on."""
        if not self._threads:
            return Work(work, None)
        with self._lock:
            if self._pool is None:
                self._pool = ThreadPoolExecutor(1, thread_name_prefix="gscpe-beside")
            return Work(work, self._pool.submit(work))

    def close(self) -> None:
        """Ends the thread; later work would start a new one."""
        with self._lock:
            if self._pool is not None:
                self._pool.shutdown(cancel_futures=True)
                self._pool = None
