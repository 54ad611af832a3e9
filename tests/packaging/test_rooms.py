# SPDX-License-Identifier: Apache-2.0
"""What rooms import, read without running them: as docs/how-it-works.md lists them, and no more
than a room needs."""

from __future__ import annotations

import ast
import re
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
    above = {"arrays", "errors", "given", "output_file"}
    assert rooms <= {*above, "evaluation", "geometry", "photos", "poses"}


def test_imports_are_followed_to_their_end() -> None:
    assert {"demo", "localization", "mapping", "render", "matching"} <= needed_rooms("demo")
    assert "evaluation" in needed_rooms("benchmark")


def listed_rooms() -> list[set[str]]:
    """The rows of the list of rooms in docs/how-it-works.md, from the top."""
    text = (ROOT / "docs" / "how-it-works.md").read_text(encoding="utf-8")
    rooms = text.split("\n## Rooms\n")[1].split("\n## ")[0]
    first_cells = [line.split("|")[1] for line in rooms.splitlines() if line.startswith("| `")]
    return [
        {name.rstrip("/").removesuffix(".py") for name in re.findall("`([^`]+)`", cell)}
        for cell in first_cells
    ]


def test_all_rooms_are_listed() -> None:
    folders = {path.parent.name for path in (ROOT / "gscpe").glob("*/__init__.py")}
    modules = {path.stem for path in (ROOT / "gscpe").glob("*.py")} - {"__init__", "__main__"}
    assert set().union(*listed_rooms()) == folders | modules


def test_rooms_import_only_from_rooms_above_them() -> None:
    rows = listed_rooms()
    row_of = {room: number for number, row in enumerate(rows) for room in row}
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for room, row in row_of.items()
        for path in (ROOT / "gscpe").glob(f"{room}/**/*.py")
        for name in imported(path)
        if row_of.get(other := name.split(".")[1], 0) >= row and other != room
    ]
    assert not wrong
