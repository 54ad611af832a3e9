# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser, which renders in software here: few Gaussians, a small window."""

from __future__ import annotations

import importlib.util
import math
import shutil
import time
from pathlib import Path
from typing import Any, Callable, Iterator

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe.geometry import se3
from gscpe.geometry.pose_error import camera_centre
from gscpe.geometry.projection import transform_points
from gscpe.scene import write_image
from gscpe.viewer import Contents, Findings, Viewer, contents_of
from gscpe.viewer.cameras import COLOURS, Viewpoint, frustum_corners

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
DRIVER = shutil.which("chromedriver")
MISSING = [name for name in ("selenium", "viser") if importlib.util.find_spec(name) is None]

pytestmark = [
    pytest.mark.skipif(BROWSER is None or DRIVER is None, reason="Chromium is not installed"),
    pytest.mark.skipif(bool(MISSING), reason=f"{', '.join(MISSING)} not installed"),
]

CAMERA = room_camera(80, 60)
POSE = se3.exp([0.1, -0.05, 0.3, 0.02, 0.1, 0.0]) @ ROOM_POSE
PATIENCE = 120.0  # seconds; a loaded machine renders a frame in some of them

OF_VISER = "THREE.BufferGeometry.computeBoundingSphere(): Computed radius is NaN"
"""viser 1.1 logs this of every splat, an empty page's too."""


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
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = str(BROWSER)
    for option in (
        *("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=900,600"),
        *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    ):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(str(DRIVER)))
    driver.set_page_load_timeout(PATIENCE)
    driver.set_script_timeout(PATIENCE)
    driver.get(viewer.url)
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def client(viewer: Viewer, chromium: Any) -> Any:
    """The server's view of the browser that has the page open."""
    clients = viewer._server.get_clients
    wait_until(lambda: bool(clients()))
    return next(iter(clients().values()))


def wait_until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.1)


def picture(chromium: Any) -> NDArray[np.float64]:
    """What the browser shows left of the panel, (H, W, 3)."""
    stored = np.frombuffer(chromium.get_screenshot_as_png(), np.uint8)
    image = cv2.imdecode(stored, cv2.IMREAD_COLOR)
    assert image is not None
    return image[:, : image.shape[1] // 2, ::-1].astype(np.float64)


def near(image: NDArray[np.float64], colour: tuple[int, int, int]) -> int:
    """Pixels of about this colour."""
    return int(np.sum(np.abs(image - colour).max(axis=2) < 40))


def test_splat_and_frusta_are_seen(viewer: Viewer, chromium: Any) -> None:
    viewer._splat_node.visible = False
    wait_until(lambda: near(picture(chromium), COLOURS["final"]) > 50)
    without = picture(chromium)
    viewer._splat_node.visible = True
    wait_until(lambda: bool(np.mean(np.abs(picture(chromium) - without).max(axis=2) > 20) > 0.005))
    for _, node in viewer._all_frusta():
        node.visible = False
    wait_until(lambda: near(picture(chromium), COLOURS["final"]) < 5)
    for _, node in viewer._all_frusta():
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
    wait_until(lambda: viewer._overlay is not None)
    assert "query.png" in viewer._about.content


def test_a_click_on_a_frustum_flies_there(viewer: Viewer, client: Any, chromium: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    viewer._leave(client)
    # From behind, so that its photo is seen in the left half: the panel is on the right.
    back = 6.0 * viewer._contents.frustum_depth
    aside = 0.5 * back * math.tan(math.radians(25.0)) * client.camera.aspect
    eye = se3.exp([-aside, 0, back, 0, 0, 0]) @ POSE
    quaternion, position = se3.to_quaternion_translation(se3.inverse(eye))
    viewer._flight.put(client, Viewpoint(position, quaternion, math.radians(50.0)))
    wait_until(lambda: bool(np.linalg.norm(client.camera.position - viewer._unit * position) < 0.1))
    time.sleep(2.0)
    query = viewer._contents.of_kind("final")[0]
    depth = viewer._contents.frustum_depth
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
    whole = len(viewer._splat_node.buffer)
    low, high = viewer._section.limits
    slider: Any = viewer._sliders[2]
    slider.value = (float(low[2]), float((low[2] + high[2]) / 2))
    viewer._cut()
    assert 0 < len(viewer._splat_node.buffer) < whole


def test_the_browser_has_no_complaints(chromium: Any, client: Any) -> None:
    log = chromium.get_log("browser")
    complaints = [entry["message"] for entry in log if entry["level"] == "SEVERE"]
    assert [text for text in complaints if OF_VISER not in text] == []
