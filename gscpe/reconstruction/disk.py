# SPDX-License-Identifier: Apache-2.0
"""Disks that are full, told as such."""

from __future__ import annotations

import errno
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import Iterator

from gscpe.errors import OutputError

_NEXT_TO_NOTHING = 2_000_000


@contextmanager
def when_full(path: Path) -> Iterator[None]:
    """Turns errors of writing into an OutputError that says what to do."""
    try:
        yield
    except OSError as error:
        hint = ""
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            hint = "; make room, and go on with --resume"
        raise OutputError(f"{path} cannot be written: {error.strerror or error}{hint}") from error


def is_full(folder: Path) -> bool:
    """Whether next to nothing can be written there; databases do not say so in a way that lasts."""
    try:
        return shutil.disk_usage(folder).free < _NEXT_TO_NOTHING
    except OSError:
        return False


def require_space(folder: Path, needed: int) -> None:
    """Raises OutputError where less than ``needed`` bytes are free, before any long work."""
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return
    if free < needed:
        raise OutputError(
            f"the disk of {folder} has {free / 1e6:.0f} MB left, and about {needed / 1e6:.0f} MB "
            "are needed; make room, or choose an output on another disk"
        )
