# SPDX-License-Identifier: Apache-2.0
"""Text files of data sets: read whole, with errors that say where a missing one comes from."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterator, Mapping, Sequence

from gscpe.errors import DatasetError
from gscpe.photos.text_file import read_text_file


def missing(path: Path, source: str) -> DatasetError:
    """The error for a file or folder that is not there; ``source`` says where to get it."""
    return DatasetError(f"{path} is missing; it comes from {source}")


@contextmanager
def reading(path: Path, source: str) -> Iterator[None]:
    """Turns what goes wrong while a text file is read into a DatasetError."""
    try:
        yield
    except FileNotFoundError:
        raise missing(path, source) from None
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path} is not a text file; download it again from {source}") from error


def read_text(path: Path, source: str) -> str:
    """The text of a file.

    Raises:
        DatasetError: the file is missing, cannot be read, or is not text.
    """
    with reading(path, source):
        return read_text_file(path)


def read_lines(path: Path, source: str) -> list[tuple[int, str]]:
    """Numbers, from 1, and texts of the lines that are neither empty nor begin with ``#``.

    Raises:
        DatasetError: see :func:`read_text`.
    """
    lines = ((i, line.strip()) for i, line in enumerate(read_text(path, source).split("\n"), 1))
    return [(i, line) for i, line in lines if line and not line.startswith("#")]


def parse_numbers(words: Sequence[str], count: int, where: str, form: str) -> list[float]:
    """Exactly ``count`` numbers.

    Args:
        where: file and line, for the error.
        form: what was expected there, for the error.

    Raises:
        DatasetError: there are more, fewer, or other words.
    """
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise DatasetError(f"{where}: expected {form!r}, got {' '.join(words)[:80]!r}")
    return numbers


def number_at(
    values: Mapping[str, Any], key: str, where: str, default: float | None = None
) -> float:
    """The number at a key of a parsed JSON or YAML file; ``default`` where there is no such key.

    Raises:
        DatasetError: the value is no number, or is missing and there is no default.
    """
    value = values.get(key, default)
    if value is None:
        raise DatasetError(f"{where}: {key} is missing")
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise DatasetError(f"{where}: {key} is not a number: {str(value)[:40]!r}") from None
