# SPDX-License-Identifier: Apache-2.0
"""Finds the GLSL sources: inside the package when installed, beside it in a checkout."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Mapping

from gscpe.errors import RenderError

_PACKAGE = Path(__file__).resolve().parent.parent
_FOLDERS = (_PACKAGE / "shaders", _PACKAGE.parent / "shaders")


def shader_source(name: str, defines: Mapping[str, int] | None = None) -> str:
    """The text of ``shaders/<name>``, as :func:`with_includes` completes it.

    Raises:
        RenderError: the file, or one that it includes, is not part of the installation.
    """
    return with_includes(_read(name), defines)


def with_includes(source: str, defines: Mapping[str, int] | None = None) -> str:
    """GLSL with ``#define`` lines put after its ``#version``, and ``#include "name"`` lines,
    which GLSL itself does not have, replaced by ``shaders/<name>``.

    Raises:
        RenderError: an included file is not part of the installation.
    """
    version, rest = source.split("\n", 1)
    lines = [f"#define {key} {value}" for key, value in (defines or {}).items()]
    return "\n".join([version, *lines, _included(rest)])


def _included(source: str) -> str:
    """Included files may include others."""
    return re.sub(
        r'^#include "([^"]+)"$', lambda match: _included(_read(match[1])), source, flags=re.M
    )


def _read(name: str) -> str:
    for folder in _FOLDERS:
        path = folder / name
        if path.is_file():
            return path.read_text()
    raise RenderError(f"shader {name} is missing from the installation; install gscpe again")
