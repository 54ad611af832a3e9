# SPDX-License-Identifier: Apache-2.0
"""Two runs into one file, files that are no pose files, more workers than photos."""

from __future__ import annotations

import importlib.util
import json
import logging
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any, Iterator, Sequence, cast

import pytest
from batch_room import CAMERA

from gscpe.batch import (
    Crew,
    Detail,
    Fingerprint,
    Instructions,
    ListFiles,
    localize_to_files,
    localize_with,
    make_crew,
    read_details,
    refuse_details,
)
from gscpe.batch.details import failed_details
from gscpe.batch.one_writer import one_writer
from gscpe.errors import OutputError, SettingsError
from gscpe.poses.hloc import read_poses
from gscpe.scene.query_list import Query

QUERIES = tuple(Query(f"{name}.png", CAMERA) for name in "abc")

needs_locks = pytest.mark.skipif(
    importlib.util.find_spec("fcntl") is None, reason="there is no flock here"
)

HOLD = """
import sys
from gscpe.batch.one_writer import one_writer
with one_writer(sys.argv[1]):
    print("held", flush=True)
    sys.stdin.read()
"""


def found(query: Query) -> Detail:
    pose = {"status": "localized", "cam_from_world": "1 0 0 0 0 0 0"}
    return failed_details(query, "") | pose


class Finds:
    """A crew that finds everything, and does something before each photo."""

    description = "finds"
    image_folder = Path("nowhere")

    def __init__(self, fingerprint: Fingerprint, before: Any = lambda: None) -> None:
        self.fingerprint, self._before = fingerprint, before

    def __enter__(self) -> Finds:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def run(self, queries: Sequence[Query]) -> Iterator[tuple[Query, Detail]]:
        for query in queries:
            self._before()
            yield query, found(query)


@pytest.fixture
def instructions(tmp_path: Path) -> Instructions:
    (tmp_path / "map.json").write_text('{"gaussians": 5}')
    return Instructions.of(tmp_path, tmp_path, matcher="sift", backend="cpu")


@needs_locks
def test_a_file_is_held_by_one(tmp_path: Path) -> None:
    """Whatever it is called, and until the other process ends, also where it is killed."""
    path, link = tmp_path / "d.jsonl", tmp_path / "link.jsonl"
    link.symlink_to(path)
    other = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert other.stdout is not None
    assert other.stdout.readline() == "held\n"
    for name in (path, link):
        refused = pytest.raises(OutputError, match=rf"another run is writing to .*{name.name}")
        with refused, one_writer(name):
            raise AssertionError("two hold it")
    other.kill()
    other.communicate(timeout=60)
    with one_writer(link):
        pass


@needs_locks
def test_a_second_run_is_refused_and_harms_nothing(
    tmp_path: Path, instructions: Instructions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither begun anew nor resumed, in this function and the one below."""
    files = ListFiles(tmp_path / "d.jsonl", tmp_path / "poses.txt")
    refused: list[bool] = []
    files.details.write_text(json.dumps(found(QUERIES[0])) + "\n")  # an earlier run's

    def second() -> None:
        poses, kept = files.final, files.details.read_bytes()
        assert poses is not None
        for resume in (False, True):
            with pytest.raises(OutputError, match="another run is writing to"):
                localize_to_files(instructions, QUERIES, files, 1, resume=resume)
            with pytest.raises(OutputError, match="another run is writing to"):
                localize_with(cast(Crew, crew), QUERIES, files.details, resume)
        assert files.details.read_bytes() == kept
        assert not poses.exists()
        refused.append(True)

    crew = Finds(instructions.fingerprint, second)
    monkeypatch.setattr("gscpe.batch.to_files.make_crew", lambda *_: crew)
    details, _ = localize_to_files(instructions, QUERIES, files, 1)
    assert len(refused) == len(QUERIES)
    assert list(read_details(files.details).values()) == details
    assert list(read_poses(tmp_path / "poses.txt")) == ["a.png", "b.png", "c.png"]
    assert (tmp_path / "d.jsonl.bak").read_text() == json.dumps(found(QUERIES[0])) + "\n"
    localize_with(cast(Crew, Finds(instructions.fingerprint)), QUERIES, files.details)


@pytest.mark.parametrize("field", ["map", "settings"])
def test_poses_are_of_this_map_and_these_settings(
    field: str, tmp_path: Path, instructions: Instructions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where somebody without a lock adds lines of another map."""
    path, poses = tmp_path / "d.jsonl", tmp_path / "poses.txt"

    def intrude() -> None:
        marks = asdict(instructions.fingerprint) | {field: "another"}
        with path.open("a") as file:
            file.write("".join(json.dumps(found(query) | marks) + "\n" for query in QUERIES))
        if b'"c.png"' in path.read_bytes() and len(path.read_bytes().splitlines()) > 4:
            raise KeyboardInterrupt

    crew = Finds(instructions.fingerprint, intrude)
    monkeypatch.setattr("gscpe.batch.to_files.make_crew", lambda *_: crew)
    with pytest.raises(KeyboardInterrupt):
        localize_to_files(instructions, QUERIES, ListFiles(path, poses), 1)
    assert set(read_details(path)) == {"a.png", "b.png", "c.png"}
    assert read_poses(poses) == {}


def test_what_fails_leaves_nothing_empty(tmp_path: Path) -> None:
    new, old = tmp_path / "new" / "d.jsonl", tmp_path / "old.jsonl"
    old.touch()
    for path in (new, old):
        with pytest.raises(KeyboardInterrupt), one_writer(path):
            assert path.exists()
            raise KeyboardInterrupt
    assert not new.exists()
    assert old.exists()


@needs_locks
def test_what_is_no_file_is_not_held() -> None:
    with one_writer(os.devnull), one_writer(os.devnull):
        pass


def test_poses_do_not_replace_details(tmp_path: Path, instructions: Instructions) -> None:
    named, other = tmp_path / "x.details.jsonl", tmp_path / "mine.txt"
    other.write_text(json.dumps(found(QUERIES[0])) + "\n")
    (tmp_path / "poses.txt").write_text("a.png 1 0 0 0 0 0 0\n")
    refuse_details([tmp_path / "poses.txt", None, tmp_path / "new.txt", tmp_path])
    for path in (named, other):
        with pytest.raises(OutputError, match="is a details file"):
            refuse_details([None, path])
        for files in (ListFiles(tmp_path / "d", path), ListFiles(tmp_path / "d", None, path)):
            with pytest.raises(OutputError, match="is a details file"):
                localize_to_files(instructions, QUERIES, files)
    assert not (tmp_path / "d").exists()


def test_never_more_processes_than_photos(
    instructions: Instructions, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    started: list[int] = []
    monkeypatch.setattr(
        "gscpe.batch.choose.ProcessCrew", lambda _, workers: started.append(workers)
    )
    monkeypatch.setattr("gscpe.batch.choose.start_worker", lambda *_: cast(Any, Finds)(None))
    monkeypatch.setenv("GSCPE_THREADS", "4")
    with caplog.at_level(logging.WARNING):
        make_crew(instructions, 9999, photos=4)
        make_crew(instructions, 9999, photos=1)  # this process alone
        assert not caplog.records
        make_crew(instructions, 9999, photos=7)
        make_crew(instructions, 32)
    assert started == [4, 7, 32]
    assert [record.getMessage().split(" are")[0] for record in caplog.records] == [
        "7 workers on 4 cores",
        "32 workers on 4 cores",
    ]
    for photos in (None, 10_000):
        with pytest.raises(SettingsError, match="33 workers are too many for 4 cores; at most 32"):
            make_crew(instructions, 33, photos=photos)
    for photos in (None, 0, 7):
        with pytest.raises(SettingsError, match="at least one worker"):
            make_crew(instructions, 0, photos=photos)


def test_poses_of_an_earlier_run_are_kept_unless_it_is_continued(
    tmp_path: Path, instructions: Instructions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where they are no poses of ours at all, such as the truth by mistake."""
    files = ListFiles(tmp_path / "d.jsonl", tmp_path / "poses.txt", tmp_path / "coarse.txt")
    crew = Finds(instructions.fingerprint)
    monkeypatch.setattr("gscpe.batch.to_files.make_crew", lambda *_: crew)
    poses, kept = tmp_path / "poses.txt", tmp_path / "poses.txt.bak"
    for path in (poses, tmp_path / "coarse.txt"):
        path.write_text("somebody's\n")
    localize_to_files(instructions, QUERIES, files, 1, resume=True)  # there is nothing to continue
    assert kept.read_text() == "somebody's\n"
    localize_to_files(instructions, QUERIES, files, 1, resume=True)
    assert kept.read_text() == "somebody's\n"
    first = poses.read_text()
    localize_to_files(instructions, QUERIES, files, 1)
    assert kept.read_text() == first
    assert (tmp_path / "coarse.txt.bak").read_text() == "somebody's\n"
