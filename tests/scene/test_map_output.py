# SPDX-License-Identifier: Apache-2.0
"""Writing maps where one must not or cannot: an OutputError, and nothing lost or left behind."""

from __future__ import annotations

import contextlib
import errno
import signal
from pathlib import Path

import numpy as np
import pytest
from helpers import assert_same_map, some_map

from gscpe.errors import OutputError
from gscpe.scene import Map, open_map, save_map
from gscpe.scene.map_folder import check_map_output


@pytest.fixture
def map_(rng: np.random.Generator) -> Map:
    return some_map(rng)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below the folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else b""
        for path in folder.rglob("*")
    }


def assert_refused(map_: Map, output: Path, root: Path) -> None:
    """Both the early check and the writing refuse it, and the disk stays as it was."""
    before = contents(root)
    with pytest.raises(OutputError) as caught:
        check_map_output(output)
    assert str(output) in str(caught.value)
    with pytest.raises(OutputError):
        save_map(map_, output)
    assert contents(root) == before


def test_a_good_output_passes_the_check(tmp_path: Path, map_: Map) -> None:
    check_map_output(tmp_path / "new.gsmap")
    assert list(tmp_path.iterdir()) == []
    save_map(map_, tmp_path / "old.gsmap")
    check_map_output(tmp_path / "old.gsmap")
    assert_same_map(open_map(tmp_path / "old.gsmap"), map_)
    assert [entry.name for entry in tmp_path.iterdir()] == ["old.gsmap"]


def test_a_file_is_in_the_way(tmp_path: Path, map_: Map) -> None:
    (tmp_path / "thesis.txt").write_text("the only copy")
    assert_refused(map_, tmp_path / "thesis.txt", tmp_path)


def test_a_folder_of_something_else_is_in_the_way(tmp_path: Path, map_: Map) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"jpg")
    assert_refused(map_, tmp_path / "photos", tmp_path)


def test_another_program_has_a_map_json_too(tmp_path: Path, map_: Map) -> None:
    (tmp_path / "game").mkdir()
    (tmp_path / "game" / "map.json").write_text('{"tiles": [1, 2, 3]}')
    (tmp_path / "game" / "save.dat").write_bytes(b"years of play")
    assert_refused(map_, tmp_path / "game", tmp_path)


def test_notes_kept_in_a_map_survive_its_replacement(tmp_path: Path, map_: Map) -> None:
    save_map(map_, tmp_path / "a.gsmap")
    (tmp_path / "a.gsmap" / "notes.txt").write_text("by hand")
    with contextlib.suppress(OutputError):
        save_map(map_, tmp_path / "a.gsmap")
    assert (tmp_path / "a.gsmap" / "notes.txt").read_text() == "by hand"
    assert_same_map(open_map(tmp_path / "a.gsmap"), map_)


@pytest.mark.parametrize("there", [True, False])
def test_what_a_link_leads_to_is_written(there: bool, tmp_path: Path, map_: Map) -> None:
    """And replaced, where it is there; the link stays a link."""
    target, link = tmp_path / "2025-06.gsmap", tmp_path / "links" / "current.gsmap"
    link.parent.mkdir()
    if there:
        save_map(some_map(np.random.default_rng(5)), target)
    link.symlink_to(target)
    check_map_output(link)
    save_map(map_, link)
    assert link.is_symlink()
    assert not target.is_symlink()
    assert_same_map(open_map(target), map_)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["2025-06.gsmap", "links"]
    assert [entry.name for entry in link.parent.iterdir()] == ["current.gsmap"]


def test_a_link_to_something_else_or_to_itself(tmp_path: Path, map_: Map) -> None:
    (tmp_path / "file").write_text("hello")
    (tmp_path / "a.gsmap").symlink_to(tmp_path / "file")
    (tmp_path / "b.gsmap").symlink_to(tmp_path / "b.gsmap")
    for name, message in (
        ("a.gsmap", "is not a gscpe map"),
        ("b.gsmap", "symbolic link to itself"),
    ):
        for write in (check_map_output, lambda folder: save_map(map_, folder)):
            with pytest.raises(OutputError, match=message):
                write(tmp_path / name)
    assert (tmp_path / "file").read_text() == "hello"


def test_ctrl_c_leaves_the_old_map_and_nothing_else(
    tmp_path: Path, map_: Map, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "a.gsmap"
    save_map(map_, folder)

    def interrupt(path: Path, data: bytes) -> int:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", interrupt)
        with pytest.raises(KeyboardInterrupt):
            save_map(some_map(rng), folder)
    assert_same_map(open_map(folder), map_)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.gsmap"]


def test_ctrl_c_while_one_map_replaces_the_other(
    tmp_path: Path, map_: Map, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is held back until the new one is there."""
    folder, new = tmp_path / "a.gsmap", some_map(rng)
    save_map(map_, folder)
    rename = Path.rename

    def interrupted_rename(path: Path, target: Path) -> Path:
        signal.raise_signal(signal.SIGINT)
        return rename(path, target)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(Path, "rename", interrupted_rename)
            with pytest.raises(KeyboardInterrupt):
                save_map(new, folder)
    finally:
        signal.signal(signal.SIGINT, before)
    assert_same_map(open_map(folder), new)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.gsmap"]


def test_an_old_map_comes_back_where_the_new_one_cannot_take_its_place(
    tmp_path: Path, map_: Map, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "a.gsmap"
    save_map(map_, folder)
    rename, calls = Path.rename, []

    def failing_rename(path: Path, target: Path) -> Path:
        calls.append(path)
        if len(calls) == 2:
            raise OSError(errno.EIO, "Input/output error")
        return rename(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", failing_rename)
        with pytest.raises(OutputError, match="Input/output error"):
            save_map(some_map(rng), folder)
    assert_same_map(open_map(folder), map_)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.gsmap"]


def test_the_parent_is_a_file(tmp_path: Path, map_: Map) -> None:
    (tmp_path / "file").write_text("hello")
    assert_refused(map_, tmp_path / "file" / "a.gsmap", tmp_path)
    assert_refused(map_, tmp_path / "file" / "deeper" / "a.gsmap", tmp_path)


def test_a_full_disk_leaves_the_old_map_and_nothing_else(
    tmp_path: Path, map_: Map, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "a.gsmap"
    save_map(map_, folder)
    write_bytes = Path.write_bytes

    def write_half(path: Path, data: bytes) -> int:
        if path.name == "references.json":
            write_bytes(path, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        return write_bytes(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", write_half)
        with pytest.raises(OutputError, match="No space left") as caught:
            save_map(some_map(rng), folder)
    assert str(folder) in str(caught.value)
    assert_same_map(open_map(folder), map_)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.gsmap"]
