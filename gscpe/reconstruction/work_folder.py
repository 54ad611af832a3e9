# SPDX-License-Identifier: Apache-2.0
"""A folder for what is not finished yet, so that a run can go on where it was interrupted."""

from __future__ import annotations

import json
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterator, Mapping

from gscpe.errors import InputError, OutputError
from gscpe.given import parse_json
from gscpe.output_file import replace_file
from gscpe.reconstruction.disk import when_full

_MARK = "run.json"
_COPIES = {"images", "masks"}


def open_work_folder(folder: Path, stamp: Mapping[str, Any], resume: bool, finished: str) -> None:
    """Makes the folder, or goes on in it.

    Args:
        folder: of this run alone.
        stamp: what the run is made of, JSON; another one's results cannot be gone on with.
        resume: go on with what is there; where nothing is, begin.
        finished: a file in it that a run writes last. What is finished is begun anew, unless
            ``resume``.

    Raises:
        OutputError: another run, or something else, is in the folder, or it cannot be written.
    """
    mark = folder / _MARK
    wanted = json.loads(json.dumps(stamp))
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not mark.exists())):
        raise OutputError(f"{folder} exists and is not of gscpe; choose another output")
    if mark.exists() and resume:
        try:
            there = parse_json(mark.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            there = None
        if there == wanted:
            return
        raise OutputError(
            f"{folder} is of a run with {_what_differs(there, wanted)}: give the same as then, or "
            "begin anew without --resume"
            + ("" if (folder / finished).exists() else f", after deleting {folder}")
        )
    if mark.exists():
        if not (folder / finished).exists():
            raise OutputError(
                f"{folder} is of a run that was interrupted: go on with --resume, or delete it"
            )
        shutil.rmtree(folder)
    with when_full(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_kept(mark, wanted)


@contextmanager
def not_kept_if_refused(folder: Path) -> Iterator[None]:
    """Around the first steps in a work folder: where they refuse what was given (InputError) before
    anything is made that a run could go on with, the folder is deleted again, so that a mistyped
    name does not have to be cleaned up after."""
    try:
        yield
    except InputError:
        if _nothing_is_made(folder):
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _nothing_is_made(folder: Path) -> bool:
    """Nothing but copies of photos and masks."""
    return all(
        path.is_dir()
        or path.name == _MARK
        or not _COPIES.isdisjoint(path.relative_to(folder).parts)
        for path in folder.rglob("*")
    )


def write_kept(path: Path, data: Any) -> None:
    """Writes a JSON file of a work folder as a whole or not at all, so that a run that was ended in
    the middle does not leave half of it to the next.

    Raises:
        OutputError: it cannot be written.
    """
    with when_full(path):
        replace_file(path, (json.dumps(data, indent=1) + "\n").encode())


def read_kept(path: Path) -> Any:
    """What :func:`write_kept` wrote.

    Raises:
        OutputError: it is damaged.
    """
    try:
        return parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise OutputError(
            f"{path} is damaged ({error}): delete {path.parent}, and begin anew"
        ) from error


def _what_differs(there: Any, wanted: Mapping[str, Any]) -> str:
    if not isinstance(there, dict):
        return "other settings"
    names = [name for name in wanted if there.get(name) != wanted[name]]
    return f"other {' and '.join(names)}" if names else "other settings"
