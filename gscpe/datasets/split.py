# SPDX-License-Identifier: Apache-2.0
"""Which photos are queries, where a data set does not say."""

from __future__ import annotations

from typing import Iterable

from gscpe.errors import SettingsError

DEFAULT_EVERY = 8


def every_nth(names: Iterable[str], every: int | None) -> frozenset[str]:
    """The first of the sorted names, and every n-th after it; None: every eighth.

    Raises:
        SettingsError: ``every`` is below 2, so that no references would be left.
    """
    step = DEFAULT_EVERY if every is None else every
    if step < 2:
        raise SettingsError(f"every must be 2 or more, not {step}: the others are the references")
    return frozenset(sorted(names)[::step])


def every_nth_text(every: int | None) -> str:
    """What :func:`every_nth` does, for people."""
    return f"1 of {DEFAULT_EVERY if every is None else every} photos"
