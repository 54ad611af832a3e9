# SPDX-License-Identifier: Apache-2.0
"""Photo names in lines of text, with blanks and backslashes, as they come."""

from __future__ import annotations

from pathlib import Path

from gscpe.errors import OutputError

QUOTE = '"'


def split_quoted_name(line: str) -> tuple[str, str] | None:
    """The name in double quotes that a line begins with, and the rest; None where there is none.

    Two quotes stand for one, as in CSV files.
    """
    if not line.startswith(QUOTE):
        return None
    end = line.find(QUOTE, 1)
    while end != -1 and line[end + 1 : end + 2] == QUOTE:
        end = line.find(QUOTE, end + 2)
    rest = line[end + 1 :]
    if end < 2 or (rest and not rest[0].isspace() and rest[0] != ","):
        return None
    return line[1:end].replace(QUOTE * 2, QUOTE), rest


def quoted_name(name: str) -> str:
    """The name, in quotes where a line of numbers could not be told from it otherwise.

    Blanks alone need none: what follows the name is found from the end of the line.

    Raises:
        OutputError: the name has a line break in it, or is empty.
    """
    if not name or len(name.splitlines()) != 1 or name.splitlines()[0] != name:
        raise OutputError(
            f"photo {name!r} cannot be in a text file of poses; only json can hold it"
        )
    words = name.split()
    plain = name == name.strip() and not name.startswith((QUOTE, "#"))
    if plain and (len(words) == 1 or not is_number(words[-1])):
        return name
    return QUOTE + name.replace(QUOTE, QUOTE * 2) + QUOTE


def name_in_folder(folder: str | Path, name: str) -> str:
    """The name with ``/`` where it has backslashes, as Windows writes them, unless there is a
    photo of the very name."""
    if "\\" not in name or (Path(folder) / name).is_file():
        return name
    return with_slashes(name)


def with_slashes(name: str) -> str:
    """``seq/a.png`` of ``seq\\a.png``."""
    return name.replace("\\", "/")


def is_number(word: str) -> bool:
    """Whether a word is a number as Python reads it."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def named_like(folder: Path, name: str) -> Path | None:
    """The picture in another folder that belongs to a photo, a mask for example: ``NAME``,
    ``NAME.png`` or the name with ``.png`` for its ending."""
    candidates = [folder / name, folder / f"{name}.png", (folder / name).with_suffix(".png")]
    return next((path for path in candidates if path.is_file()), None)
