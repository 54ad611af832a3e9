# SPDX-License-Identifier: Apache-2.0
"""Linear algebra uses one thread while somebody asks for it, and as many as before after that."""

from __future__ import annotations

import threading

import pytest
import scipy.linalg
from threadpoolctl import ThreadpoolController

from gscpe.blas import one_blas_thread


def threads() -> set[int]:
    """Of each library for linear algebra."""
    assert scipy.linalg is not None  # it brings a library of its own
    found = ThreadpoolController().select(user_api="blas").lib_controllers
    return {library.num_threads for library in found}


@pytest.fixture(autouse=True)
def three_threads() -> object:
    with ThreadpoolController().limit(limits=3, user_api="blas"):
        if threads() != {3}:
            pytest.skip("NumPy's linear algebra has no threads that can be set")
        yield


def test_one_thread_while_it_is_asked_for() -> None:
    with one_blas_thread():
        assert threads() == {1}
        with one_blas_thread():
            assert threads() == {1}
        assert threads() == {1}
    assert threads() == {3}


def test_it_is_set_back_after_an_error() -> None:
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        raise ZeroDivisionError
    assert threads() == {3}


def test_threads_that_overlap_leave_what_they_found() -> None:
    """The first leaves before the second: neither may set back for the other."""
    first_is_in, second_is_in, first_is_out = (threading.Event() for _ in range(3))
    seen: list[set[int]] = []

    def first() -> None:
        with one_blas_thread():
            first_is_in.set()
            second_is_in.wait(10)
        first_is_out.set()

    def second() -> None:
        first_is_in.wait(10)
        with one_blas_thread():
            second_is_in.set()
            first_is_out.wait(10)
            seen.append(threads())

    both = [threading.Thread(target=work) for work in (first, second)]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join()
    assert seen == [{1}]
    assert threads() == {3}
