# SPDX-License-Identifier: Apache-2.0
"""The room's map and photos in a folder, for the tests of crews."""

from __future__ import annotations

import functools
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Iterable

from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe.batch import Crew, Instructions, make_crew
from gscpe.geometry import se3
from gscpe.photos import write_image
from gscpe.scene import save_map
from gscpe.scene.query_list import Query

CAMERA = room_camera(240, 180)
QUERIES = tuple(Query(f"{name}.png", CAMERA) for name in "abcd")
TRAP = Query("trap.png", CAMERA)
"""A worker that reads this photo waits until it is killed; see :meth:`RoomFolder.set_trap`."""


@dataclass(frozen=True)
class RoomFolder:
    """``room.gsmap``, and the photos of QUERIES in ``photos/``; d.png is missing."""

    path: Path

    @property
    def instructions(self) -> Instructions:
        return Instructions.of(self.path / "room.gsmap", self.path / "photos", matcher="sift")

    @functools.cached_property
    def expected(self) -> dict[str, Any]:
        """Of QUERIES and of the trap's photo, by this process."""
        self.disarm()
        with make_crew(self.instructions) as crew:
            return run(crew, (TRAP, *QUERIES))

    def set_trap(self) -> None:
        """Makes the trap's photo a pipe that nobody writes into."""
        (self.path / "photos" / TRAP.name).unlink(missing_ok=True)
        os.mkfifo(self.path / "photos" / TRAP.name)

    def disarm(self) -> None:
        """Makes it a photo; a worker that waits goes on waiting."""
        photo = self.path / "photos" / "disarmed.png"
        photo.write_bytes((self.path / "photos" / "a.png").read_bytes())
        photo.replace(self.path / "photos" / TRAP.name)


def make_room(folder: Path) -> RoomFolder:
    """Writes map and photos."""
    save_map(room_map(), folder / "room.gsmap")
    for number, query in enumerate(QUERIES[:3]):
        pose = se3.exp([0.05, -0.03, 0.01 * number, 0.02, -0.02, 0.03]) @ ROOM_POSE
        write_image(folder / "photos" / query.name, room().shoot(CAMERA, pose).uint8)
    return RoomFolder(folder)


def run(crew: Crew, queries: Iterable[Query]) -> dict[str, Any]:
    """Details by name, without the times, which are never the same."""
    details = {}
    for query, detail in crew.run(tuple(queries)):
        assert detail.pop("name") == query.name
        assert query.name not in details
        detail.pop("seconds")
        details[query.name] = detail
    return details


def wait_until(true: Callable[[], Any], seconds: float = 60.0) -> Any:
    """What is true at last."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := true():
            return found
        time.sleep(0.02)
    raise AssertionError("it did not become true")
