# SPDX-License-Identifier: Apache-2.0
"""What a room may need: followed through all its imports, without running them."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def needed_rooms(room: str) -> set[str]:
    """The rooms of gscpe that a room's modules import, at the top or inside of functions, and
    those that these import, and so on."""
    seen: set[Path] = set()
    todo = list((ROOT / "gscpe" / room).glob("*.py"))
    while todo:
        path = todo.pop()
        if path in seen:
            continue
        seen.add(path)
        for name in imported(path):
            parts = name.split(".")
            # Down to the module; "from gscpe.room import name" ends at the room's __init__.
            for depth in range(2, len(parts) + 1):
                folder = ROOT.joinpath(*parts[:depth])
                todo += [
                    p for p in (folder / "__init__.py", folder.with_suffix(".py")) if p.exists()
                ]
    return {path.relative_to(ROOT / "gscpe").parts[0].removesuffix(".py") for path in seen}


def imported(path: Path) -> list[str]:
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return [name for name in names if name.startswith("gscpe.")]


def test_evaluation_needs_no_map() -> None:
    """Poses and errors can be evaluated without what finds poses, makes maps or renders."""
    rooms = needed_rooms("evaluation")
    assert {"evaluation", "geometry", "poses", "errors"} <= rooms
    assert rooms <= {"arrays", "errors", "evaluation", "geometry", "photos", "poses"}


def test_imports_are_followed_to_their_end() -> None:
    assert {"demo", "localization", "mapping", "render", "matching"} <= needed_rooms("demo")
    assert "evaluation" in needed_rooms("benchmark")
