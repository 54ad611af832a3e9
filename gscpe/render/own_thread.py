# SPDX-License-Identifier: Apache-2.0
"""Threads for OpenGL alone.

A context is current in one thread at a time. To hand it over, one thread must let it go before the
next takes it; which context that is depends on the client API that EGL has bound in that thread
(OpenGL ES where nobody asked for another); and glcontext does not look whether a change succeeded,
so that what follows a failed one draws nothing, or into another context. So a context stays in the
thread that made it, as moderngl's authors advise (moderngl/moderngl#623): from which threads calls
come does not matter then, and contexts that callers have made current in theirs are not touched.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Callable, TypeVar

_T = TypeVar("_T")


class OwnThread:
    """Does what it is given, one after the other, in a thread that does nothing else."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gscpe-opengl")

    def run(self, work: Callable[[], _T]) -> _T:
        """What ``work`` returns, or raises, there."""
        return self._pool.submit(work).result()

    def end(self, work: Callable[[], None]) -> None:
        """Does a last thing there, and ends the thread. Nothing where Python is shutting down and
        has ended it before: the driver frees what a process leaves."""
        try:
            last: Future[None] | None = self._pool.submit(work)
        except RuntimeError:
            last = None
        self._pool.shutdown()
        if last is not None:
            last.result()


def in_own_thread(work: Callable[[], _T]) -> _T:
    """What ``work`` returns, or raises, in a thread for it alone."""
    with ThreadPoolExecutor(1, thread_name_prefix="gscpe-opengl") as pool:
        return pool.submit(work).result()
