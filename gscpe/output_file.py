# SPDX-License-Identifier: Apache-2.0
"""Files that are written as a whole or not at all: a full disk or a signal in the middle leaves
what was there before."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from contextlib import suppress
from pathlib import Path

from gscpe.errors import OutputError
from gscpe.given import real_path

_NOT_BESIDE = (errno.EACCES, errno.EPERM, errno.EBUSY, errno.EXDEV)
"""Of a folder in which no other file may be made, or of a file that is mounted by itself, as into
a container: only the file itself can be written."""


def write_file(path: str | Path, data: bytes) -> None:
    """As :func:`replace_file`; folders are made as needed.

    Raises:
        OutputError: it cannot be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, data)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from error


def replace_file(path: Path, data: bytes) -> None:
    """Writes beside the file and renames. A link stays one, and what it leads to is replaced; what
    is no regular file (``/dev/stdout``, a pipe) is written to.

    Raises:
        OSError: it cannot be written.
    """
    path = real_path(path)
    if path.is_symlink() and not path.exists():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    if path.exists() and not path.is_file():
        path.write_bytes(data)
        return
    part = path.with_name(f".{secrets.token_hex(4)}.part")
    try:
        part.write_bytes(data)
        if path.exists():
            with suppress(OSError):  # a file system without permissions
                shutil.copymode(path, part)
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        if error.errno not in _NOT_BESIDE or not path.is_file():
            raise
        path.write_bytes(data)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
