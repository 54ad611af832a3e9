# SPDX-License-Identifier: Apache-2.0
"""Every source file says its licence at its top."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LINE = "SPDX-License-Identifier: Apache-2.0"
FOLDERS = ("gscpe", "shaders", "tests", "tools", "examples")
COMMENTS = {
    **dict.fromkeys((".py", ".sh", ""), f"# {LINE}"),
    **dict.fromkeys((".vert", ".frag", ".comp", ".glsl", ".js"), f"// {LINE}"),
    **dict.fromkeys((".css",), f"/* {LINE} */"),
    **dict.fromkeys((".jinja",), f"{{# {LINE} -#}}"),
}


def test_every_source_file_has_the_line() -> None:
    sources = [
        path
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and path.suffix in COMMENTS and "__pycache__" not in path.parts
    ]
    assert len(sources) > 200
    missing = []
    for path in sources:
        lines = path.read_text(encoding="utf-8").splitlines()
        # What must be first by another rule stays first: an interpreter, a GLSL version.
        place = 1 if lines and lines[0].startswith(("#!", "#version")) else 0
        if lines[place : place + 1] != [COMMENTS[path.suffix]]:
            missing.append(str(path.relative_to(ROOT)))
    assert not missing
