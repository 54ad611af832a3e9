# SPDX-License-Identifier: Apache-2.0
"""All that callers need is in ``gscpe`` itself: no public signature names a type that is not."""

from __future__ import annotations

import dataclasses
import inspect
import re
import typing
from pathlib import Path
from typing import Any, Iterator

import pytest

import gscpe
from gscpe import errors

PUBLIC = {name: getattr(gscpe, name) for name in gscpe.__all__}
EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "examples").glob("*.py"))


def types_in(hint: Any) -> Iterator[type]:
    """All classes of ours that a type hint names, at any depth."""
    if isinstance(hint, type) and hint.__module__.startswith("gscpe."):
        yield hint
    for part in typing.get_args(hint):
        if isinstance(part, list | tuple):  # the arguments of a Callable
            for inner in part:
                yield from types_in(inner)
        else:
            yield from types_in(part)


def signature_types(function: Any) -> set[type]:
    hints = typing.get_type_hints(function, localns=PUBLIC)
    return {found for hint in hints.values() for found in types_in(hint)}


def public_callables(owner: type) -> Iterator[tuple[str, Any]]:
    for name, _ in inspect.getmembers_static(owner):
        if name.startswith("_") and name != "__init__":
            continue
        member = inspect.getattr_static(owner, name)
        if isinstance(member, property):
            yield name, member.fget
        elif isinstance(member, classmethod | staticmethod):
            yield name, member.__func__
        elif inspect.isfunction(member):
            yield name, member


def needed_types(thing: Any) -> set[type]:
    """The classes of ours that whoever uses this function or class has to do with."""
    if not isinstance(thing, type):
        return signature_types(thing)
    is_dataclass = dataclasses.is_dataclass(thing)  # whose fields are what __init__ takes
    needed = {
        found
        for name, call in public_callables(thing)
        if not (is_dataclass and name == "__init__")
        for found in signature_types(call)
    }
    if is_dataclass:
        hints = typing.get_type_hints(thing, localns=PUBLIC)
        for field in dataclasses.fields(thing):
            needed.update(types_in(hints[field.name]))
    return needed


def test_names_are_sorted_and_there() -> None:
    assert gscpe.__all__ == sorted(set(gscpe.__all__))
    assert set(gscpe.__all__) <= set(dir(gscpe))


@pytest.mark.parametrize("name", gscpe.__all__)
def test_types_in_public_signatures_are_public(name: str) -> None:
    missing = needed_types(PUBLIC[name]) - set(PUBLIC.values())
    assert not missing, f"{name} needs {sorted(kind.__qualname__ for kind in missing)}"


@pytest.mark.parametrize("name", gscpe.__all__)
def test_what_is_public_is_documented(name: str) -> None:
    thing = PUBLIC[name]
    text = inspect.getdoc(thing)
    assert text and not text.startswith(f"{name}("), f"{name} has no docstring"
    if isinstance(thing, type):
        for member, call in public_callables(thing):
            assert member == "__init__" or inspect.getdoc(call), f"{name}.{member}"


def test_the_walk_finds_what_is_missing() -> None:
    class Inner:
        def use(self, index: dict[str, tuple[gscpe.Map, ...]] | None) -> list[gscpe.Photo]:
            raise NotImplementedError

    assert needed_types(Inner) == {gscpe.Map, gscpe.Photo}


def test_all_errors_are_public() -> None:
    ours = {kind for kind in vars(errors).values() if isinstance(kind, type)}
    assert ours <= set(PUBLIC.values())


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'localize'"):
        gscpe.localize  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("example", EXAMPLES, ids=[path.name for path in EXAMPLES])
def test_examples_use_public_names_alone(example: Path) -> None:
    text = example.read_text()
    assert "from gscpe" not in text
    assert "import gscpe." not in text
    names = set(re.findall(r"\bgscpe\.([A-Za-z_]+)", text))
    assert names and names <= set(gscpe.__all__)
