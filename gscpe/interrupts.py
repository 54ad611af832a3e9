# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C, and the signals by which the surroundings end a program: as one, later, or not at all.

Signals reach the main thread, and only there can they be handled. What is here does nothing in
another one.
"""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager
from types import FrameType
from typing import Iterator

_ENDS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Slurm, containers and systemd send SIGTERM; a terminal that is closed, SIGHUP."""

_ALL = (signal.SIGINT, *_ENDS)


class Terminated(KeyboardInterrupt):
    """What a signal of the surroundings raises, wherever the program is.

    Attributes:
        signal: the signal.
        status: the exit status that a shell expects, 143 for SIGTERM.
    """

    def __init__(self, number: int) -> None:
        self.signal = signal.Signals(number)
        self.status = 128 + number
        super().__init__(f"ended by {self.signal.name}")


@contextmanager
def terminated_like_interrupts() -> Iterator[None]:
    """SIGTERM and SIGHUP raise :class:`Terminated`, once: what is done to end well is left alone.
    One that was ignored before (``nohup``) stays so."""
    raised: list[int] = []

    def end(number: int, _: FrameType | None) -> None:
        if not raised:
            raised.append(number)
            raise Terminated(number)

    with _restored(_ENDS):
        for number in _ENDS:
            if _in_main_thread() and signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, end)
        yield


@contextmanager
def handlers_kept() -> Iterator[None]:
    """What is done at SIGTERM and SIGHUP is the same after. For the import of pycolmap, which
    else makes SIGTERM print forty lines that look like a crash."""
    with _restored(_ENDS):
        yield


@contextmanager
def interrupts_later() -> Iterator[list[int]]:
    """Holds signals back until the end, and lists what was held back: for what must not be left
    half done, and for callbacks in which an exception is lost (those of Numba's compiler)."""
    received: list[int] = []
    try:
        with _restored(_ALL):
            for number in _ALL:
                if _in_main_thread() and signal.getsignal(number) not in (signal.SIG_IGN, None):
                    signal.signal(number, lambda number, _: received.append(number))
            yield received
    finally:
        for number in received[:1]:
            signal.raise_signal(number)


@contextmanager
def born_without_interrupts() -> Iterator[None]:
    """A process that is started meanwhile has these signals blocked from its first moment; here,
    they are only delayed."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # or start() would, and unblock them
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ALL)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore_interrupts() -> None:
    """In a process of several: Ctrl-C reaches every process of a terminal, and SIGTERM often all
    of a job; the one that began the work ends the others."""
    for number in _ALL:
        signal.signal(number, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _ALL)


@contextmanager
def _restored(numbers: tuple[signal.Signals, ...]) -> Iterator[None]:
    """Handlers that others, or C code, set meanwhile are undone."""
    before = {number: signal.getsignal(number) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            if _in_main_thread() and handler is not None:
                signal.signal(number, handler)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
