# SPDX-License-Identifier: Apache-2.0
"""How many cores there are to use."""

from __future__ import annotations

import os

from gscpe.errors import SettingsError

VARIABLE = "GSCPE_THREADS"
"""The environment variable that says how many cores to use."""


def available_cores() -> int:
    """Cores that this process may use; in a container they can be fewer than the machine's.

    Raises:
        SettingsError: the variable ``GSCPE_THREADS`` is set, but to no number of cores.
    """
    asked = os.environ.get(VARIABLE)
    if asked:
        if not (asked.isdecimal() and int(asked)):
            raise SettingsError(f"GSCPE_THREADS must be a positive number, not {asked!r}")
        return int(asked)
    if hasattr(os, "sched_getaffinity"):  # Linux
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
