# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser, as a phone shows it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ContextManager, Iterator

import pytest
from batch_room import CAMERA, RoomFolder, make_room, wait_until
from browser import chromium, needs_browser
from serving import Serving, serving

from gscpe.batch import shelf_order
from gscpe.service.service import Service, ServiceSettings

pytestmark = needs_browser("fastapi")

TOKEN = "0123456789abcdef0123"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> RoomFolder:
    return make_room(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="module")
def server(room: RoomFolder) -> Iterator[Serving]:
    order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
    with serving(Service(order, ServiceSettings(token=TOKEN))) as server:
        yield server


@pytest.fixture(scope="module")
def phone() -> Iterator[Any]:
    with phone_chromium() as driver:
        yield driver


def phone_chromium(*options: str) -> ContextManager[Any]:
    """A phone; its camera sees Chromium's own test picture unless options say otherwise."""
    return chromium(
        "--use-fake-device-for-media-stream",
        "--use-fake-ui-for-media-stream",
        *options,
        phone={"width": 390, "height": 844, "pixelRatio": 2.0, "mobile": True},
    )


def text(phone: Any, name: str) -> str:
    return str(phone.find_element("id", name).get_attribute("textContent"))


def write(phone: Any, name: str, value: str) -> None:
    script = (
        "const field = document.getElementById(arguments[0]); field.value = arguments[1];"
        "field.dispatchEvent(new Event('change'));"
    )
    phone.execute_script(script, name, value)


def test_a_photo_and_its_place(
    phone: Any, server: Serving, room: RoomFolder, tmp_path: Path
) -> None:
    phone.get(server.url)
    wait_until(lambda: "needs its token" in text(phone, "status"))
    assert phone.execute_script("return document.getElementById('more').open")
    write(phone, "token", TOKEN)
    wait_until(lambda: phone.find_elements("css selector", "#drawing svg image"))
    write(phone, "camera", CAMERA.colmap_text())
    phone.get_log("browser")  # the missing token was logged

    phone.find_element("id", "choose").send_keys(str(room.path / "photos" / "a.png"))
    wait_until(lambda: text(phone, "status") == "Found.", 120)
    widths = "return ['photo', 'render'].map(id => document.getElementById(id).naturalWidth)"
    wait_until(lambda: phone.execute_script(widths) == [240, 240])
    x, y, width, height = phone.execute_script(
        "const circle = document.querySelector('#here circle'), svg = circle.ownerSVGElement;"
        "return [circle.cx.baseVal.value, circle.cy.baseVal.value, svg.viewBox.baseVal.width,"
        " svg.viewBox.baseVal.height]"
    )
    assert 0 < x < width
    assert 0 < y < height
    assert "Standard deviations" in text(phone, "facts")
    boxes = "return ['photo', 'render'].map(id => {const b = document.getElementById(id)"
    boxes += ".getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom]})"
    photo, render = phone.execute_script(boxes)
    assert photo[1] == render[1]  # beside each other
    assert photo[2] <= render[0]
    page = "return [document.documentElement.scrollWidth, innerWidth]"
    scroll, inner = phone.execute_script(page)
    assert inner == 390
    assert scroll <= inner  # nothing sticks out
    phone.save_screenshot(str(tmp_path / "page.png"))
    assert phone.get_log("browser") == []
    names = "return performance.getEntriesByType('resource').map(entry => entry.name)"
    for name in phone.execute_script(names):
        assert name.startswith((server.url, "data:", f"blob:{server.url}"))

    write(phone, "camera", "")
    bad = tmp_path / "<img src=x onerror=alert(1)>.jpg"
    bad.write_bytes(b"no photo")
    phone.find_element("id", "choose").send_keys(str(bad))
    wait_until(lambda: "is not an image" in text(phone, "status"))
    assert "<img src=x" in text(phone, "status")
    assert not phone.find_elements("css selector", "#status img")


def test_the_live_camera(phone: Any, server: Serving) -> None:
    """Chromium's own test picture is nowhere in the map."""
    phone.get(server.url)
    write(phone, "token", TOKEN)
    wait_until(lambda: phone.find_elements("css selector", "#drawing svg image"))
    live = phone.find_element("id", "live")
    assert live.is_displayed()
    phone.execute_script("document.getElementById('live').click()")
    wait_until(lambda: text(phone, "status").startswith("Not found: "), 120)
    assert text(phone, "live") == "Stop"
    phone.execute_script("document.getElementById('live').click()")
    assert text(phone, "live") == "Live camera"
    assert text(phone, "status") == ""
