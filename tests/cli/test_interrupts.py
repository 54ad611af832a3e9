# SPDX-License-Identifier: Apache-2.0
"""Signals: as Ctrl-C, later, or as they were."""

from __future__ import annotations

import signal
import threading
from typing import Iterator

import pytest

from gscpe.interrupts import (
    Terminated,
    handlers_kept,
    interrupts_later,
    terminated_like_interrupts,
)

TERM = signal.SIGTERM


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Known at the beginning, whatever the tests run in; as before at the end."""
    before = [(number, signal.getsignal(number)) for number in (TERM, signal.SIGINT)]
    signal.signal(TERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in before:
        signal.signal(number, handler)


def test_it_is_raised_once() -> None:
    """A second one must not break off what the first one set going."""
    with terminated_like_interrupts():
        with pytest.raises(KeyboardInterrupt) as caught:
            signal.raise_signal(TERM)
        signal.raise_signal(TERM)
    assert isinstance(caught.value, Terminated)
    assert (caught.value.signal, caught.value.status) == (TERM, 143)
    assert signal.getsignal(TERM) == signal.SIG_DFL


def test_what_was_ignored_stays_ignored() -> None:
    signal.signal(TERM, signal.SIG_IGN)
    with terminated_like_interrupts():
        signal.raise_signal(TERM)
    assert signal.getsignal(TERM) == signal.SIG_IGN


def test_a_librarys_handler_does_not_stay() -> None:
    with terminated_like_interrupts():
        with handlers_kept():
            signal.signal(TERM, signal.SIG_IGN)
        with pytest.raises(Terminated):
            signal.raise_signal(TERM)


@pytest.mark.parametrize("number", [TERM, signal.SIGINT])
def test_later(number: signal.Signals) -> None:
    done = []
    with terminated_like_interrupts():
        with pytest.raises(KeyboardInterrupt), interrupts_later():
            signal.raise_signal(number)
            done.append(number)
        assert done == [number]
        with interrupts_later():  # nothing came
            pass


def test_in_another_thread_nothing_is_done() -> None:
    """Only the main thread may set handlers."""
    handlers = []

    def work() -> None:
        with terminated_like_interrupts(), interrupts_later(), handlers_kept():
            handlers.append(signal.getsignal(TERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [signal.SIG_DFL]
