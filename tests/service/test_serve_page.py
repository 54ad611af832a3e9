# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser, as a phone shows it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ContextManager, Iterator

import cv2
import moving_camera
import pytest
from batch_room import CAMERA, RoomFolder, wait_until
from browser import chromium, needs_browser
from serving import TOKEN, Serving, serving

from gscpe.batch import shelf_order
from gscpe.geometry import pose_difference
from gscpe.poses.hloc import parse_pose
from gscpe.service.service import Service, ServiceSettings

pytestmark = needs_browser("fastapi")


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


def write_film(path: Path) -> None:
    """Back and forth through the room, in the form that Chromium's camera plays over and over."""
    steps = (*range(8), *range(7, 0, -1))
    with path.open("wb") as file:
        file.write(b"YUV4MPEG2 W240 H180 F5:1 Ip A1:1 C420jpeg\n")
        for step in steps:
            yuv = cv2.cvtColor(moving_camera.picture(step), cv2.COLOR_RGB2YUV_I420)
            file.write(b"FRAME\n" + yuv.tobytes())


def text(phone: Any, name: str) -> str:
    return str(phone.find_element("id", name).get_attribute("textContent"))


def render_shown(phone: Any) -> str:
    return str(phone.find_element("id", "render").get_attribute("src"))


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
    assert not phone.find_element("id", "render").is_displayed()  # there is nothing to see
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


def test_a_camera_is_followed(server: Serving, tmp_path: Path) -> None:
    """From the first frame, which is localized, on: its pose moves as the film does."""
    write_film(tmp_path / "film.y4m")
    with phone_chromium(f"--use-file-for-fake-video-capture={tmp_path / 'film.y4m'}") as phone:
        phone.get(server.url)
        write(phone, "token", TOKEN)
        wait_until(lambda: phone.find_elements("css selector", "#drawing svg image"))
        write(phone, "camera", CAMERA.colmap_text())
        phone.get_log("browser")
        phone.execute_script("document.getElementById('live').click()")
        wait_until(lambda: text(phone, "status") == "Following the camera.", 120)
        assert phone.find_element("id", "video").is_displayed()
        first = render_shown(phone)
        seen = set()

        def different() -> bool:
            facts = text(phone, "facts")
            if "Milliseconds" in facts:
                seen.add(facts.partition("Standard")[0])
            return len(seen) > 2

        wait_until(different, 120)
        for pose in seen:
            found = parse_pose(pose.removeprefix("Pose"))
            apart = [pose_difference(found, moving_camera.pose(step)) for step in range(8)]
            assert min(error.distance for error in apart) < 0.03
        wait_until(lambda: render_shown(phone) != first, 120)  # it goes along
        assert phone.find_elements("css selector", "#here circle")
        phone.save_screenshot(str(tmp_path / "following.png"))
        phone.execute_script("document.getElementById('live').click()")
        assert text(phone, "live") == "Live camera"
        assert phone.get_log("browser") == []
