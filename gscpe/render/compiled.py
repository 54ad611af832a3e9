# SPDX-License-Identifier: Apache-2.0
"""Compiles a loop with Numba, and keeps it on disk where there is a place for that.

Numba compiles anew what has changed in a loop's own file; of a change in this one it knows nothing
(delete ``__pycache__/*.nb?``).
"""

from __future__ import annotations

import functools
import logging
import os
import stat
import tempfile
from pathlib import Path
from typing import Any, Callable, Collection

import numba

_config: Any = numba.config  # its types do not know what it holds
_log = logging.getLogger(__name__)


def compiled(
    fastmath: Collection[str] = (), inline: bool = False
) -> Callable[[Callable[..., Any]], Any]:
    """Decorator for loops that release the GIL.

    They are kept where NUMBA_CACHE_DIR says, in the package's folder, or in the user's cache. A
    user other than the one who installed gscpe, without a home, has none of these: then they
    are kept in a folder of the temporary one, or compiled by each process (said once, in the log).

    Args:
        fastmath: liberties that the compiler may take, as LLVM names them; without, those of the
            loop that calls it.
        inline: put it into the loops that call it, before they are compiled.
    """

    options: dict[str, Any] = {"fastmath": set(fastmath)} if fastmath else {}
    if inline:
        options["inline"] = "always"

    def decorate(loop: Callable[..., Any]) -> Any:
        return numba.njit(cache=_has_place(), nogil=True, error_model="numpy", **options)(loop)

    return decorate


@functools.cache
def _has_place() -> bool:
    """Whether there is a folder for what was compiled; the temporary one is chosen here."""
    has_home = os.path.expanduser("~") != "~"  # or Numba would make a folder of the name ~
    if (has_home or _config.CACHE_DIR) and _can_keep():
        return True
    folder = _private_folder()
    if folder is not None:
        _config.CACHE_DIR = str(folder)
        if _can_keep():
            _log.warning(
                "keeping the compiled CPU rasterizer in %s: neither gscpe's folder nor a home "
                "directory is writable (NUMBA_CACHE_DIR sets another folder)",
                folder,
            )
            return True
    _log.warning(
        "each process compiles the CPU rasterizer again: no writable folder was found to keep it "
        "in (NUMBA_CACHE_DIR sets one)"
    )
    return False


def _can_keep() -> bool:
    try:
        numba.njit(cache=True)(_can_keep)  # not compiled; Numba looks for a folder
    except RuntimeError:  # no locator available
        return False
    return True


def _private_folder() -> Path | None:
    """A folder of this user's alone: code is run that is read from it."""
    user = os.getuid() if hasattr(os, "getuid") else ""
    try:
        folder = Path(tempfile.gettempdir()) / f"gscpe-numba-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    ours = not hasattr(os, "getuid") or (found.st_uid == user and not found.st_mode & 0o077)
    return folder if ours and stat.S_ISDIR(found.st_mode) else None
