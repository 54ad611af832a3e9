# SPDX-License-Identifier: Apache-2.0
"""Files are written as a whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from gscpe.errors import OutputError
from gscpe.output_file import replace_file, write_file


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_new_files_and_folders(tmp_path: Path) -> None:
    write_file(tmp_path / "a" / "b.txt", b"1")
    assert (tmp_path / "a" / "b.txt").read_bytes() == b"1"
    assert names(tmp_path / "a") == {"b.txt"}
    longest = tmp_path / ("x" * 255)
    write_file(longest, b"2")
    assert longest.read_bytes() == b"2"


def test_links_and_permissions_stay(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_bytes(b"old")
    target.chmod(0o640)
    link.symlink_to("target")
    write_file(link, b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "no space"), KeyboardInterrupt()])
def test_an_end_in_the_middle_leaves_what_was_there(
    error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "poses.txt"
    path.write_bytes(b"old")
    whole = Path.write_bytes

    def half(self: Path, data: bytes) -> int:
        whole(self, data[: len(data) // 2])
        raise error

    monkeypatch.setattr(Path, "write_bytes", half)
    wanted = OutputError if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(wanted):
        write_file(path, b"new poses")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == {"poses.txt"}


def test_where_nothing_can_be_put_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a file that is mounted into a container by itself."""
    path = tmp_path / "poses.txt"
    path.write_bytes(b"old and longer")

    def busy(*_: object) -> None:
        raise OSError(errno.EBUSY, "busy")

    monkeypatch.setattr(os, "replace", busy)
    write_file(path, b"new")
    assert path.read_bytes() == b"new"
    assert names(tmp_path) == {"poses.txt"}
    with pytest.raises(OutputError, match="busy"):
        write_file(tmp_path / "other.txt", b"new")


def test_pipes_are_written_to(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        replace_file(pipe, b"poses")
        assert os.read(reader, 100) == b"poses"
    finally:
        os.close(reader)
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_what_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path, tmp_path / "file" / "below"):
        with pytest.raises(OutputError, match="cannot be written"):
            write_file(path, b"")


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="Unix")
def test_what_leads_to_a_pipe_without_a_name_is_written_to() -> None:
    """As /dev/stdout does, where another program reads it."""
    reader, writer = os.pipe()
    try:
        write_file(f"/dev/fd/{writer}", b"poses")
        assert os.read(reader, 99) == b"poses"
    finally:
        os.close(reader)
        os.close(writer)
