"""Writing maps where one must not or cannot: an OutputError, and nothing lost or left behind."""

from __future__ import annotations

import contextlib
import errno
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
