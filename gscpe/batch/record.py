# SPDX-License-Identifier: Apache-2.0
"""The record of what is finished: one JSON object a line, so that it can be resumed.

A photo that cannot be read fails alone. The pose files are written from the record, and
resuming reads it: photos that failed, that have changed, or whose camera, map or settings have
changed, are done again.
"""

from __future__ import annotations

import json
import logging
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Callable, Iterable, Mapping, Sequence

from tqdm import tqdm

from gscpe.batch.crew import Crew, SerialCrew
from gscpe.batch.details import Detail, camera_details, read_details
from gscpe.batch.fingerprint import photo_fingerprint
from gscpe.batch.one_writer import one_writer
from gscpe.batch.worker import Worker
from gscpe.errors import OutputError
from gscpe.given import real_path
from gscpe.localization import Localizer
from gscpe.output_file import replace_file
from gscpe.scene.query_list import Query

_log = logging.getLogger(__name__)

Told = Callable[[Detail], None]
"""Who is told of each photo."""

_CHANGED = {
    "map": "they were localized with another map",
    "settings": "they were localized with another matcher or other settings",
    "photo": "their files have changed since",
    "camera": "their cameras are others, or known otherwise",
}
"""Fields of a detail that must be as they were, and what it means where they are not."""


def localize_list(
    localizer: Localizer,
    queries: Sequence[Query],
    image_folder: str | Path,
    details_path: str | Path,
    resume: bool = False,
    progress: bool = False,
) -> list[Detail]:
    """Localizes every query in this process and returns their details, in the order of the list.

    Since the map may be one that is on no disk, resuming does not notice another map.

    Args:
        localizer: of the map.
        queries: photos and cameras.
        image_folder: that their names are relative to.
        details_path, resume, progress: as :func:`localize_with`.

    Raises:
        OutputError: the details cannot be written.
        RenderError: OpenGL failed.
    """
    crew = SerialCrew(Worker(localizer, image_folder))  # not closed: the localizer is the caller's
    return localize_with(crew, queries, details_path, resume, progress)


def localize_with(
    crew: Crew,
    queries: Sequence[Query],
    details_path: str | Path,
    resume: bool = False,
    progress: bool = False,
    told: Told | None = None,
) -> list[Detail]:
    """Has a crew localize every query and returns their details, in the order of the list.

    Args:
        crew: see :func:`gscpe.batch.make_crew`; it is left open.
        queries: photos and cameras.
        details_path: gets a line a query as soon as it is finished, in any order.
        resume: keep what is in ``details_path`` already and still holds; otherwise it is begun
            anew, and what was there is kept beside it with the ending ``.bak``.
        progress: show a bar.
        told: is given each detail as soon as it is on disk, those that are kept first.

    Raises:
        OutputError: the details cannot be written, or another run is writing them.
        GscpeError: what the crew raises.
    """
    with one_writer(details_path):
        return record(crew, queries, Path(details_path), resume, progress, told)


def record(
    crew: Crew,
    queries: Sequence[Query],
    details_path: Path,
    resume: bool,
    progress: bool,
    told: Told | None,
) -> list[Detail]:
    """As :func:`localize_with`, for who is the details' :func:`one_writer` already."""
    marks: dict[str, str] = asdict(crew.fingerprint) if crew.fingerprint else {}
    finished = _still_true(crew, queries, read_details(details_path), marks) if resume else {}
    if not resume:
        keep_a_copy(details_path, stays=True)
    # Rewritten, so that a line cut off by the interruption does not stay.
    _write(details_path, finished.values(), "w")
    if told is not None:
        for kept in finished.values():
            told(kept)
    localized = sum(detail["status"] == "localized" for detail in finished.values())
    with tqdm(total=len(queries), unit="photo", disable=not (progress and sys.stderr)) as bar:
        bar.update(len(finished))
        for query, detail in crew.run([q for q in queries if q.name not in finished]):
            finished[query.name] = detail | marks
            _write(details_path, [finished[query.name]], "a")
            if told is not None:
                told(finished[query.name])
            localized += detail["status"] == "localized"
            bar.update()
            bar.set_postfix_str(f"{localized} localized")
    return [finished[query.name] for query in queries]


def _still_true(
    crew: Crew,
    queries: Sequence[Query],
    before: Mapping[str, Detail],
    marks: Mapping[str, str],
) -> dict[str, Detail]:
    """What need not be done again; one warning for each of photos, cameras, map and
    settings that changed."""
    kept = {}
    changed = dict.fromkeys(_CHANGED, 0)
    for query in queries:
        detail = before.get(query.name)
        if not detail or detail["status"] == "failed":
            continue
        other = [field for field in marks if detail.get(field) != marks[field]]
        its_camera = camera_details(query.camera)
        if not other and any(detail.get(field) != its_camera[field] for field in its_camera):
            other = ["camera"]
        if not other and detail.get("photo") != photo_fingerprint(crew.image_folder / query.name):
            other = ["photo"]
        for field in other:
            changed[field] += 1
        if not other:
            kept[query.name] = detail
    for field, count in changed.items():
        if count:
            _log.warning(
                "localizing %d photos again: %s (or this was not recorded)", count, _CHANGED[field]
            )
    return kept


def keep_a_copy(path: Path, stays: bool = False) -> None:
    """Renames an earlier run's file, if it holds anything, to one with the ending ``.bak``.

    Args:
        path: of the file.
        stays: it is copied instead, since it is held (:func:`one_writer`).

    Raises:
        OutputError: it cannot be renamed or copied.
    """
    try:
        if path.is_file() and path.stat().st_size:
            path = real_path(path)  # a link stays one
            backup = path.with_name(path.name + ".bak")
            if stays:
                replace_file(backup, path.read_bytes())
            else:
                path.replace(backup)
            _log.warning("the earlier results are kept in %s", backup)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from error


def _write(path: Path, details: Iterable[Detail], mode: str) -> None:
    """Closed after each line: it is on disk, and visible to other machines, at once."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open(mode, encoding="utf-8") as file:
            file.write("".join(json.dumps(detail) + "\n" for detail in details))
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from error
