# SPDX-License-Identifier: Apache-2.0
"""One run at a time writes a file: another one is refused, instead of mixing its results in."""

from __future__ import annotations

import errno
import os
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Iterator

from gscpe.errors import OutputError
from gscpe.given import real_path

_HELD = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EACCES)


@contextmanager
def one_writer(path: str | Path) -> Iterator[None]:
    """Holds a file for as long as it is written, whatever process or thread else wants to.

    The lock is the system's (``flock``): it ends with the process, however that ends. Where there
    is none (Windows, some network file systems, what is no regular file), nothing is held.

    Args:
        path: of the file, which must be written in place. It is made if it is not there, and
            removed again where the work fails before anything is in it.

    Raises:
        OutputError: another run is writing to it, or it cannot be written.
    """
    target = real_path(path)  # the same file by another name is the same
    if target.exists() and not target.is_file() and not target.is_dir():  # a pipe
        yield
        return
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        new = not target.exists()
        file = _hold(target)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from error
    if file is None:
        raise OutputError(
            f"another run is writing to {path}; wait for its end, or choose another output"
        )
    with file:
        try:
            yield
        except BaseException:
            with suppress(OSError):
                if new and not target.stat().st_size:
                    target.unlink()
            raise


def _hold(path: Path) -> IO[bytes] | None:
    """The locked file; None where another one holds it."""
    while True:
        file = path.open("ab")
        try:
            if not _lock(file):
                file.close()
                return None
            if _is_at(file, path):
                return file
        except BaseException:
            file.close()
            raise
        file.close()  # who held it has removed it meanwhile


def _lock(file: IO[bytes]) -> bool:
    """Whether it is not held by another one."""
    try:
        import fcntl
    except ImportError:  # Windows
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:  # others: a file system without locks
        return error.errno not in _HELD
    return True


def _is_at(file: IO[bytes], path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False
