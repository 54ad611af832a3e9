# SPDX-License-Identifier: Apache-2.0
"""A list from instructions to files, also where it is interrupted: whether they can be written,
and the pose files."""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Mapping, Sequence

from gscpe.batch.choose import choose_workers, make_crew
from gscpe.batch.details import Detail, read_details
from gscpe.batch.instructions import Instructions
from gscpe.batch.one_writer import one_writer
from gscpe.batch.record import Told, keep_a_copy, record
from gscpe.errors import OutputError
from gscpe.given import parse_json, real_path
from gscpe.output_file import write_file
from gscpe.photos.photo_name import quoted_name
from gscpe.scene.query_list import Query

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ListFiles:
    """Where results go: the record, and pose files of the final and the coarse poses.

    Poses in several maps belong to several worlds, so each map has pose files of its own
    (:func:`map_path`).
    """

    details: Path
    final: Path | None = None
    coarse: Path | None = None


def localize_to_files(
    instructions: Instructions,
    queries: Sequence[Query],
    files: ListFiles,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    progress: bool = False,
    told: Told | None = None,
) -> tuple[list[Detail], str]:
    """The queries' details, in their order, and who worked.

    Where it is interrupted, the poses of what is finished are written all the same. Pose files of
    an earlier run that is not continued are kept, with the ending ``.bak``, as its details are.

    Args:
        instructions: of the workers.
        queries: photos and cameras.
        files: to write.
        workers: processes, never more than queries; None: what is faster here, unless there is
            a scheduler.
        scheduler, progress: as :func:`gscpe.batch.make_crew`.
        resume, told: as :func:`gscpe.batch.localize_with`.

    Raises:
        OutputError: a file cannot be written, another run is writing the details, a pose file is
            to replace a details file, or a photo's name cannot be in a pose file (before anything
            is done).
        GscpeError: what making a crew and its work raise.
    """
    refuse_details([files.final, files.coarse])
    if files.final is not None or files.coarse is not None:
        for query in queries:
            quoted_name(query.name)
    if workers is None:
        workers = 1 if scheduler else choose_workers(instructions, len(queries))
    with (
        one_writer(files.details),
        make_crew(instructions, workers, scheduler, progress, len(queries)) as crew,
    ):
        _log.info("%s", crew.description)
        if not (resume and read_details(files.details)):
            for poses in _pose_files(files, instructions):
                keep_a_copy(poses, stays=True)  # until the new poses replace it
        try:
            details = record(crew, queries, files.details, resume, progress, told)
            return details, crew.description
        finally:
            done = _finished(files.details, queries, instructions)
            for path, stage in ((files.final, "final"), (files.coarse, "coarse")):
                if path is not None:
                    _write_of_each_map(done, path, stage, instructions)
            if len(done) < len(queries):
                _log.warning(
                    "%d of %d photos are finished; run the same again with resume (--resume) to "
                    "continue",
                    *(len(done), len(queries)),
                )


def _finished(path: Path, queries: Sequence[Query], instructions: Instructions) -> list[Detail]:
    """Of this very map and these settings: where there are no locks, another run may have
    written to the file."""
    details, marks = read_details(path), asdict(instructions.fingerprint)
    there = [details[query.name] for query in queries if query.name in details]
    return [detail for detail in there if detail.items() >= marks.items()]


def _pose_files(files: ListFiles, instructions: Instructions) -> list[Path]:
    given = [path for path in (files.final, files.coarse) if path is not None]
    if instructions.shelf is None:
        return given
    return [map_path(path, name) for path in given for name in instructions.shelf.folders]


def _write_of_each_map(
    details: Sequence[Detail], path: Path, stage: str, instructions: Instructions
) -> None:
    if instructions.shelf is None:
        write_poses(details, path, stage)
        return
    for name in instructions.shelf.folders:
        there = [detail for detail in details if detail.get("map_name") == name]
        write_poses(there, map_path(path, name), stage)


def map_path(path: str | Path, map_: str) -> Path:
    """Where the poses in one of several maps go: ``poses.kitchen.txt`` for ``poses.txt``."""
    path = Path(path)
    return path.with_name(f"{path.stem}.{map_}{path.suffix}")


def check_outputs(paths: Sequence[str | Path | None], inputs: Sequence[str | Path] = ()) -> None:
    """Raises OutputError, before any long work, when one of the files cannot be written, is
    one of the inputs, or comes twice."""
    taken = {real_path(path) for path in inputs}
    for path in (Path(path) for path in paths if path is not None):
        target = real_path(path)  # a link stays, also one to a file that is not there yet
        if target in taken:
            raise OutputError(f"{path} is given twice; each input and output needs its own file")
        taken.add(target)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            new = not target.exists()
            with target.open("a"):
                pass
            if new:  # nothing empty is left behind where the work fails
                target.unlink()
        except OSError as error:
            raise OutputError(f"{path} cannot be written: {error.strerror}") from error


def refuse_details(paths: Sequence[str | Path | None]) -> None:
    """Raises OutputError where a pose file would replace the details of an earlier run: by its
    name (``.details.jsonl``), or what is in it."""
    for path in (Path(path) for path in paths if path is not None):
        if path.name.endswith(".details.jsonl") or _holds_details(path):
            raise OutputError(
                f"{path} is a details file, which poses would replace; give another name for the "
                "poses, such as poses.txt (--details is for details)"
            )


def _holds_details(path: Path) -> bool:
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            detail = parse_json(file.readline())
    except (OSError, ValueError):
        return False
    return isinstance(detail, dict) and detail.keys() >= {"name", "camera", "cam_from_world"}


def write_poses(details: Sequence[Mapping[str, Any]], path: str | Path, stage: str) -> None:
    """Writes hloc's pose file with the localized photos' poses of a stage.

    Args:
        details: of :func:`gscpe.batch.localize_list`; the file has their order.
        path: of the pose file.
        stage: ``"final"``; or that of one stage alone, ``"coarse"`` or ``"aligned"``.

    Raises:
        OutputError: the file cannot be written.
    """
    lines = []
    for detail in details:
        source = detail if stage == "final" else detail[stage]
        if detail["status"] == "localized" and source is not None:
            lines.append(f"{quoted_name(str(detail['name']))} {source['cam_from_world']}\n")
    # A name that is no text in this file system's encoding is kept as it is.
    write_file(path, "".join(lines).encode("utf-8", "surrogateescape"))
