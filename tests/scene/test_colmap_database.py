# SPDX-License-Identifier: Apache-2.0
"""Names of photos in a COLMAP database, while pycolmap reads lists of pairs."""

from __future__ import annotations

from pathlib import Path

import pytest

from gscpe.scene.colmap_database import numbered_names, restore_names

pycolmap = pytest.importorskip("pycolmap")

NAMES = ("a b.jpg", "#c.jpg", "sub dir/Küche (1).jpg", "7", "plain.jpg")


@pytest.fixture
def database(tmp_path: Path) -> Path:
    path = tmp_path / "database.db"
    camera = pycolmap.Camera(model="PINHOLE", width=8, height=6, params=[9, 9, 4, 3])
    with pycolmap.Database.open(path) as stored:
        number = stored.write_camera(camera)
        for name in NAMES:
            stored.write_image(pycolmap.Image(name=name, camera_id=number))
    return path


def names_in(database: Path) -> dict[str, int]:
    with pycolmap.Database.open(database) as stored:
        return {str(image.name): int(image.image_id) for image in stored.read_all_images()}


def test_photos_have_numbers_meanwhile(database: Path) -> None:
    before = names_in(database)
    with numbered_names(database) as numbers:
        assert numbers == before
        assert set(names_in(database)) == {str(number) for number in before.values()}
    assert names_in(database) == before
    with pytest.raises(ValueError, match="trouble"), numbered_names(database):
        raise ValueError("trouble")
    assert names_in(database) == before


def test_whoever_was_killed_meanwhile_gets_the_names_back(database: Path) -> None:
    before = names_in(database)
    killed = numbered_names(database)
    killed.__enter__()
    assert names_in(database) != before
    restore_names(database)
    assert names_in(database) == before
    restore_names(database)
    assert names_in(database) == before
    with numbered_names(database) as numbers:
        assert numbers == before


def test_no_database_is_made(tmp_path: Path) -> None:
    restore_names(tmp_path / "none.db")
    assert not (tmp_path / "none.db").exists()
