# SPDX-License-Identifier: Apache-2.0
"""Localizers of several maps, as many as there is room for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from batch_room import RoomFolder

from gscpe import MapError
from gscpe.batch import shelf_order


def test_a_map_that_was_built_anew_is_refused(room: RoomFolder) -> None:
    from gscpe.batch.shelf import Shelf

    order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
    changed = replace(order, fingerprints={"room": "0" * 12})
    with Shelf(changed) as shelf, pytest.raises(MapError, match="has changed since"):
        shelf.localizer("room")


def test_a_shelf_makes_room(room: RoomFolder, tmp_path: Path) -> None:
    import shutil

    from gscpe.batch.shelf import Shelf, map_bytes

    folders = []
    for name in "abc":
        folders.append(str(tmp_path / f"{name}.gsmap"))
        shutil.copytree(room.path / "room.gsmap", folders[-1])
    size = map_bytes(Path(folders[0]))
    order = shelf_order(folders, matcher="sift", memory=int(2.5 * size))
    with Shelf(order) as shelf:
        first = shelf.localizer("a")
        shelf.localizer("b")
        assert shelf.localizer("a") is first
        shelf.localizer("c")
        assert shelf.held == ("a", "c")
    with Shelf(replace(order, memory=1)) as shelf:
        shelf.localizer("a")
        shelf.localizer("b")
        assert shelf.held == ("b",)
