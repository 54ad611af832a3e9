#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes docs/api.md: what gscpe offers to Python, from its docstrings.

Usage: python tools/write_api_docs.py [OUTPUT]
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, Iterator

import gscpe

OUTPUT = Path(__file__).resolve().parents[1] / "docs" / "api.md"

# What a program meets first comes first; rooms that are not here come after, by name.
_FIRST = ("localization", "photos", "splats", "scene", "mapping", "geometry", "render", "matching")
_LAST = ("datasets", "benchmark", "evaluation", "report", "errors")
_SECTION = re.compile(r"(Args|Attributes|Raises|Returns|Yields):")
_ENTRY = re.compile(r"([\w*][\w*, ]*?): +(\S.*)")
_ROLE = re.compile(r":(?:class|func|meth|mod|attr):`~?([^`]+)`")
_WIDTH = 92

_HEAD = """# Python API

Everything below is in `gscpe` itself: `import gscpe`, then `gscpe.Localizer`, ... The modules
beneath it may change. Frames, pixels and units are those of [conventions](conventions.md); arrays
are NumPy's.

This page is written from the docstrings by `tools/write_api_docs.py`.
"""


def page() -> str:
    """The whole page."""
    rooms: dict[str, list[str]] = {}
    for name in gscpe.__all__:
        rooms.setdefault(getattr(gscpe, name).__module__.split(".")[1], []).append(name)
    parts = [_HEAD]
    ordered = sorted(rooms, key=_place)
    for room in ordered:
        links = ", ".join(f"[`{name}`](#{name.lower()})" for name in rooms[room])
        parts.append(f"- **{room}**: {links}")
    for room in ordered:
        about = (inspect.getdoc(import_module(f"gscpe.{room}")) or "").partition("\n\n")[0]
        parts.append(f"\n## {room}\n\n{_markdown(about)}")
        parts.extend(_section(name, getattr(gscpe, name)) for name in rooms[room])
    return "\n".join(parts) + "\n"


def _place(room: str) -> tuple[int, str]:
    if room in _FIRST:
        return _FIRST.index(room), room
    return len(_FIRST) + 1 + (_LAST.index(room) + 1 if room in _LAST else 0), room


def _section(name: str, thing: Any) -> str:
    parts = [f"\n### {name}\n"]
    if isinstance(thing, type) and issubclass(thing, Exception):
        parts.append(f"A kind of `{thing.__bases__[0].__name__}`. {_doc(thing)}")
        return "\n".join(parts)
    if not isinstance(thing, type):
        return "\n".join([*parts, _code(_signature(name, thing)), "", _doc(thing)])
    if dataclasses.is_dataclass(thing):
        shown = [_field(field) for field in dataclasses.fields(thing)]
        parts.append(_code(_call(f"class {name}", shown, "")))
    elif "__init__" in vars(thing) and not getattr(thing, "_is_protocol", False):
        parts.append(_code(_signature(f"class {name}", vars(thing)["__init__"])))
    parts += ["", _doc(thing)]
    for member, kind, function in _members(thing):
        text = f"{name}.{member}"
        if kind == "property":
            returns = inspect.signature(function).return_annotation
            parts.append(f"\n#### {text}\n\n{_code(f'{member}: {returns}')}")
        else:
            parts.append(f"\n#### {text}\n\n{_code(_signature(member, function))}")
        parts += ["", _doc(function)]
    return "\n".join(parts)


def _members(owner: type) -> Iterator[tuple[str, str, Any]]:
    """Public methods and properties: name, kind and function, in the order of the source."""
    seen: dict[str, tuple[str, str, Any]] = {}
    for base in reversed(owner.__mro__):
        if not base.__module__.startswith("gscpe."):
            continue
        for name, member in vars(base).items():
            if name.startswith("_"):
                continue
            if isinstance(member, property):
                seen[name] = (name, "property", member.fget)
            elif isinstance(member, classmethod | staticmethod):
                seen[name] = (name, "class", member.__func__)
            elif inspect.isfunction(member):
                seen[name] = (name, "method", member)
    return iter(seen.values())


def _field(field: dataclasses.Field[Any]) -> str:
    text = f"{field.name}: {field.type}"
    if field.default is not dataclasses.MISSING:
        return f"{text} = {field.default!r}"
    if field.default_factory is not dataclasses.MISSING:
        return f"{text} = {getattr(field.default_factory, '__name__', '...')}()"
    return text


def _signature(name: str, function: Any) -> str:
    """As in the source, without self and cls."""
    signature = inspect.signature(function)
    shown = []
    keyword_only = False
    for parameter in signature.parameters.values():
        if parameter.name in ("self", "cls"):
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and not keyword_only:
            keyword_only = True
            shown.append("*")
        text = parameter.name
        if parameter.annotation is not parameter.empty:
            text += f": {parameter.annotation}"
        if parameter.default is not parameter.empty:
            text += f" = {parameter.default!r}"
        shown.append(text)
    returns = signature.return_annotation
    is_class = name.startswith("class ")
    return _call(name, shown, "" if is_class or returns is signature.empty else f" -> {returns}")


def _call(name: str, shown: list[str], end: str) -> str:
    line = f"{name}({', '.join(shown)}){end}"
    if len(line) <= _WIDTH or not shown:
        return line
    return "\n".join([f"{name}(", *(f"    {part}," for part in shown), f"){end}"])


def _code(text: str) -> str:
    return f"```python\n{text}\n```"


def _doc(thing: Any) -> str:
    return _markdown(inspect.getdoc(thing) or "")


def _markdown(text: str) -> str:
    """Of a docstring: its sections become lists, and what it refers to becomes links."""
    lines: list[str] = []
    in_section = False
    for line in text.splitlines():
        heading = _SECTION.fullmatch(line.strip()) if not line.startswith(" ") else None
        if heading:
            in_section = True
            lines += [f"**{heading[1]}**", ""]
        elif in_section and line.startswith("    "):
            entry = _ENTRY.fullmatch(line[4:]) if not line.startswith("     ") else None
            lines.append(f"- `{entry[1]}`: {entry[2]}" if entry else f"  {line.strip()}")
        else:
            in_section = in_section and not line.strip()
            lines.append(line)
    return _ROLE.sub(_reference, "\n".join(lines)).replace("``", "`").rstrip()


def _reference(role: re.Match[str]) -> str:
    name = role[1].removeprefix("gscpe.")
    owner = name.split(".")[-1] if name.split(".")[-1] in gscpe.__all__ else name.split(".")[0]
    if owner not in gscpe.__all__:
        return f"`{role[1]}`"
    anchor = name.replace(".", "").lower() if name.startswith(f"{owner}.") else owner.lower()
    return f"[`{owner if name.endswith(owner) else name}`](#{anchor})"


if __name__ == "__main__":
    output = Path(sys.argv[1]) if len(sys.argv) > 1 else OUTPUT
    output.write_text(page(), encoding="utf-8")
    print(output)
