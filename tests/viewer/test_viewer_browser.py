# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser, which renders in software here: few Gaussians, a small window."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any, Iterator

import numpy as np
import pytest
from browser import needs_browser
from scenes import ROOM_POSE, room, room_camera, room_map
from viewing import complaints, near, picture, viewing_chromium, wait_until

from gscpe.geometry import se3
from gscpe.geometry.pose_error import camera_centre
from gscpe.geometry.projection import transform_points
from gscpe.photos import write_image
from gscpe.viewer import Contents, Findings, Viewer, contents_of
from gscpe.viewer.cameras import COLOURS, Viewpoint, frustum_corners

pytestmark = needs_browser("viser")

CAMERA = room_camera(80, 60)
POSE = se3.exp([0.1, -0.05, 0.3, 0.02, 0.1, 0.0]) @ ROOM_POSE


@pytest.fixture(scope="module")
def contents() -> Contents:
    return contents_of(room_map(), Findings(poses={"query.png": POSE}, truth={"query.png": POSE}))


@pytest.fixture(scope="module")
def viewer(contents: Contents, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Viewer]:
    folder: Path = tmp_path_factory.mktemp("photos")
    query = next(c for c in contents.cameras if c.kind == "final")
    write_image(folder / "query.png", room().shoot(query.camera, POSE).uint8)
    with Viewer(room_map(), contents, [folder], name="room", most_gaussians=4000) as viewer:
        yield viewer


@pytest.fixture(scope="module")
def chromium(viewer: Viewer) -> Iterator[Any]:
    with viewing_chromium() as driver:
        driver.get(viewer.url)
        yield driver


@pytest.fixture(scope="module")
def client(viewer: Viewer, chromium: Any) -> Any:
    """The server's view of the browser that has the page open."""
    clients = viewer._server.get_clients
    wait_until(lambda: bool(clients()))
    return next(iter(clients().values()))


def test_splat_and_frusta_are_seen(viewer: Viewer, chromium: Any) -> None:
    viewer._cut.node.visible = False
    wait_until(lambda: near(picture(chromium), COLOURS["final"]) > 50)
    without = picture(chromium)
    viewer._cut.node.visible = True
    wait_until(lambda: bool(np.mean(np.abs(picture(chromium) - without).max(axis=2) > 20) > 0.005))
    for _, node in viewer._nodes.frusta():
        node.visible = False
    wait_until(lambda: near(picture(chromium), COLOURS["final"]) < 5)
    for _, node in viewer._nodes.frusta():
        node.visible = True


def test_a_click_on_a_name_flies_there_and_lays_the_photo_over(
    viewer: Viewer, client: Any, chromium: Any
) -> None:
    goal = viewer._unit * camera_centre(POSE)
    assert np.linalg.norm(client.camera.position - goal) > 0.1 * viewer._unit
    (field,) = [
        each
        for each in chromium.find_elements("css selector", "input")
        if each.get_attribute("value") == "\N{EM DASH}" and each.is_displayed()
    ][:1]
    chromium.execute_script("arguments[0].scrollIntoView()", field)
    field.click()
    options = "//*[@role='option'][contains(., 'query.png')]"
    wait_until(lambda: bool(chromium.find_elements("xpath", options)))
    chromium.execute_script("arguments[0].click()", chromium.find_element("xpath", options))
    wait_until(lambda: bool(np.linalg.norm(client.camera.position - goal) < 1e-3 * viewer._unit))
    wait_until(lambda: viewer._photos.overlay is not None)
    assert "query.png" in viewer._photos.about.content


def test_a_click_on_a_frustum_flies_there(
    viewer: Viewer, contents: Contents, client: Any, chromium: Any
) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    viewer._photos.leave(client, viewer._photos.afar)
    # From behind, so that its photo is seen in the left half: the panel is on the right.
    back = 6.0 * contents.frustum_depth
    aside = 0.5 * back * math.tan(math.radians(25.0)) * client.camera.aspect
    eye = se3.exp([-aside, 0, back, 0, 0, 0]) @ POSE
    quaternion, position = se3.to_quaternion_translation(se3.inverse(eye))
    viewer._flight.put(client, Viewpoint(position, quaternion, math.radians(50.0)))
    wait_until(lambda: bool(np.linalg.norm(client.camera.position - viewer._unit * position) < 0.1))
    time.sleep(2.0)
    query = contents.of_kind("final")[0]
    depth = contents.frustum_depth
    middle = frustum_corners(query.camera, query.cam_from_map, depth)[1:5].mean(axis=0)
    x, y, z = transform_points(eye, middle[None])[0]
    width, height = client.camera.image_width, client.camera.image_height
    focal = height / 2 / math.tan(math.radians(25.0))
    canvas = chromium.find_element("css selector", "canvas")
    from_middle = (
        round(focal * x / z * canvas.size["width"] / width),
        round(focal * y / z * canvas.size["height"] / height),
    )
    # Small as the window is, the panel and a note about software rendering may lie there.
    chromium.execute_script(
        """
        const box = arguments[0].getBoundingClientRect();
        const x = box.left + box.width / 2 + arguments[1];
        const y = box.top + box.height / 2 + arguments[2];
        let above = document.elementFromPoint(x, y);
        while (above && above.tagName !== "CANVAS") {
            above.style.display = "none";
            above = document.elementFromPoint(x, y);
        }
        """,
        *(canvas, *from_middle),
    )
    ActionChains(chromium).move_to_element_with_offset(canvas, *from_middle).click().perform()
    goal = viewer._unit * camera_centre(POSE)
    wait_until(lambda: bool(np.linalg.norm(client.camera.position - goal) < 1e-3 * viewer._unit))


def test_a_section_leaves_fewer_gaussians(viewer: Viewer, client: Any) -> None:
    whole = len(viewer._cut.node.buffer)
    low, high = viewer._cut.section.limits
    slider: Any = viewer._cut.sliders[2]
    slider.value = (float(low[2]), float((low[2] + high[2]) / 2))
    viewer._cut.cut()
    assert 0 < len(viewer._cut.node.buffer) < whole


def test_the_browser_has_no_complaints(chromium: Any, client: Any) -> None:
    assert complaints(chromium) == []
