# SPDX-License-Identifier: Apache-2.0
"""Services of a small map, and of workers that do what photos say."""

from __future__ import annotations

from typing import Any, Callable, Iterator

import pytest
from batch_room import RoomFolder, make_room
from fake_desk import FakeDesk
from serving import Serving, serving

from gscpe import Client
from gscpe.batch import shelf_order
from gscpe.service.limits import Limits
from gscpe.service.service import Service, ServiceSettings

LIMITS = Limits(body_bytes=2_000_000, pixels=1_000_000)


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> RoomFolder:
    return make_room(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="module")
def server(room: RoomFolder) -> Iterator[Serving]:
    order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
    with serving(Service(order, ServiceSettings(workers=2, limits=LIMITS))) as serving_:
        yield serving_


@pytest.fixture
def client(server: Serving) -> Iterator[Client]:
    with Client(server.url) as client:
        yield client


@pytest.fixture
def fake(room: RoomFolder, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Service]:
    """Services whose workers do what photos say (they need no map)."""
    monkeypatch.setattr("gscpe.service.app.check_photo", lambda *_: (1, 1))

    def make(**settings: Any) -> Service:
        order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
        return Service(order, ServiceSettings(**settings), FakeDesk.start)

    return make
