# SPDX-License-Identifier: Apache-2.0
"""When photos were taken, from their names or from a file."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Mapping, Sequence

from gscpe.errors import SequenceError
from gscpe.photos.photo_name import is_number, with_slashes
from gscpe.photos.text_file import read_text_file
from gscpe.poses import photo_numbers

_NUMBERS = re.compile(r"(\d+)")
_SINCE_1970 = {10: 1, 13: 10**3, 16: 10**6, 19: 10**9}
"""Digits of a whole number of seconds, milli-, micro- and nanoseconds since 1970 (from 2001 to
2286), and how many of them are a second."""


def in_natural_order(names: Sequence[str]) -> list[str]:
    """By name, where numbers count as numbers: ``frame-9`` comes before ``frame-10``."""

    def key(name: str) -> list[tuple[bool, int, str]]:
        parts = _NUMBERS.split(name)
        return [(i % 2 == 1, int(p) if i % 2 else 0, p) for i, p in enumerate(parts)]

    return sorted(names, key=key)


def times_of_names(names: Sequence[str]) -> list[float] | None:
    """Seconds, where all photos are named by their time; else None.

    A time has a decimal point (``1311868164.363181.png``), or is a whole number of seconds, milli-,
    micro- or nanoseconds since 1970 (10, 13, 16 or 19 digits). Other whole numbers number frames.
    """
    numbers = photo_numbers(names)
    if numbers is None:
        return None
    if all("." in number for number in numbers):
        return [float(number) for number in numbers]
    digits = {len(number) for number in numbers}
    if len(digits) == 1 and (each := digits.pop()) in _SINCE_1970:
        return [int(number) / _SINCE_1970[each] for number in numbers]
    return None


def read_times(path: str | Path, names: Sequence[str]) -> list[float]:
    """The times of photos, from a file of lines ``name seconds`` or ``seconds name`` (as TUM's
    rgb.txt); or of seconds alone, one a photo, in their order.

    Raises:
        SequenceError: the file cannot be read, has other lines, or lacks a photo.
    """
    try:
        text = read_text_file(path)
    except OSError as error:
        raise SequenceError(f"times {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise SequenceError(f"{path} is not a text file of times") from error
    alone: list[float] = []
    named: dict[str, float] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) == 1 and is_number(words[0]):
            alone.append(float(words[0]))
        elif len(words) > 1 and is_number(words[0]):
            named[with_slashes(" ".join(words[1:]))] = float(words[0])
        elif len(words) > 1 and is_number(words[-1]):
            named[with_slashes(" ".join(words[:-1]))] = float(words[-1])
        else:
            raise SequenceError(
                f"{path}, line {number}: expected 'name seconds', 'seconds name', or seconds "
                f"alone, got {line.strip()[:60]!r}"
            )
    if alone and named:
        raise SequenceError(f"{path} has lines with a name and lines without: give one form")
    if alone:
        if len(alone) != len(names):
            raise SequenceError(
                f"{path} has {len(alone)} times for {len(names)} photos: give one a photo, or "
                "lines 'name seconds'"
            )
        return _finite(alone, path)
    return _finite([_time_of(name, named, path) for name in names], path)


def _time_of(name: str, named: Mapping[str, float], path: str | Path) -> float:
    """By the whole name, or by the file's name alone where that is unique."""
    if name in named:
        return named[name]
    short = name.rsplit("/", 1)[-1]
    same = [time for other, time in named.items() if other.rsplit("/", 1)[-1] == short]
    if len(same) != 1:
        raise SequenceError(f"{path} has {'no time' if not same else 'several times'} for {name}")
    return same[0]


def _finite(times: list[float], path: str | Path) -> list[float]:
    if not all(map(math.isfinite, times)):
        raise SequenceError(f"{path} holds a time that is not finite")
    return times
