"""Finds the GLSL sources: inside the package when installed, beside it in a checkout."""

from __future__ import annotations

from pathlib import Path
from typing import Mapping

from gscpe.errors import RenderError

_PACKAGE = Path(__file__).resolve().parent.parent
_FOLDERS = (_PACKAGE / "shaders", _PACKAGE.parent / "shaders")


def shader_source(name: str, defines: Mapping[str, int] | None = None) -> str:
    """The text of ``shaders/<name>`` with ``#define`` lines put after its ``#version``.

    Raises:
        RenderError: the file is not part of the installation.
    """
    for folder in _FOLDERS:
        path = folder / name
        if path.is_file():
            version, rest = path.read_text().split("\n", 1)
            lines = [f"#define {key} {value}" for key, value in (defines or {}).items()]
            return "\n".join([version, *lines, rest])
    raise RenderError(f"shader {name} is missing from the installation; install gscpe again")
