# SPDX-License-Identifier: Apache-2.0
"""Fixtures (a plugin of conftest.py): services of a small map, and services whose workers do what
photos say. What they need is imported when they are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable, Iterator

import pytest

if TYPE_CHECKING:
    from batch_room import RoomFolder
    from serving import Serving

    from gscpe import Client
    from gscpe.service.service import Service


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> RoomFolder:
    """The room's map and photos in a folder, which nobody changes."""
    from batch_room import make_room

    return make_room(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="module")
def server(room: RoomFolder) -> Iterator[Serving]:
    """A real server with two workers."""
    from serving import serving

    from gscpe.batch import shelf_order
    from gscpe.service.limits import Limits
    from gscpe.service.service import Service, ServiceSettings

    order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
    limits = Limits(body_bytes=2_000_000, pixels=1_000_000)
    with serving(Service(order, ServiceSettings(workers=2, limits=limits))) as serving_:
        yield serving_


@pytest.fixture
def client(server: Serving) -> Iterator[Client]:
    """Of the server."""
    from gscpe import Client

    with Client(server.url) as client:
        yield client


@pytest.fixture
def fake(room: RoomFolder, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Service]:
    """Services whose workers do what photos say (they need no map)."""
    from fake_desk import FakeDesk

    from gscpe.batch import shelf_order
    from gscpe.service.service import Service, ServiceSettings

    monkeypatch.setattr("gscpe.service.app.check_photo", lambda *_: (1, 1))

    def make(**settings: Any) -> Service:
        order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
        return Service(order, ServiceSettings(**settings), FakeDesk.start)

    return make
