# SPDX-License-Identifier: Apache-2.0
"""The report in a real browser: tools/test --full installs what this needs."""

from __future__ import annotations

import importlib.util
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, Iterator

import pytest
from report_runs import EVIL, room_run
from scenes import room_map

from gscpe import Localizer
from gscpe.matching import SiftMatcher
from gscpe.report import ReportSettings, write_report

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
DRIVER = shutil.which("chromedriver")

pytestmark = [
    pytest.mark.skipif(BROWSER is None or DRIVER is None, reason="Chromium is not installed"),
    pytest.mark.skipif(
        importlib.util.find_spec("selenium") is None, reason="selenium is not installed"
    ),
]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser")
    matcher = SiftMatcher()
    with Localizer(room_map(), matcher=matcher) as localizer:
        run = room_run(localizer, folder)
        settings = ReportSettings(queries=4)
        write_report(folder / "report.html", run, localizer, folder, settings, matcher)
        small, none = replace(run, metres_per_unit=1e-4), ReportSettings(queries=0)
        write_report(folder / "small.html", small, localizer, folder, none)
    return folder / "report.html"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = str(BROWSER)
    for option in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(str(DRIVER)))
    driver.set_page_load_timeout(30)
    driver.execute_cdp_cmd("Network.enable", {})
    offline = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
    driver.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
    yield driver
    driver.quit()


@pytest.fixture
def browser(chromium: Any, page: Path) -> Any:
    """The page, freshly loaded without a network; what the tests before logged is gone."""
    chromium.get_log("browser")
    chromium.get(page.as_uri())
    return chromium


def column(browser: Any, index: int) -> list[str]:
    script = (
        "return [...document.querySelectorAll('table.sortable tbody tr')]"
        ".map(row => row.cells[arguments[0]].textContent.trim())"
    )
    return [str(text) for text in browser.execute_script(script, index)]


def click_head(browser: Any, text: str) -> int:
    heads = browser.find_elements("css selector", "table.sortable thead button")
    (index,) = [i for i, head in enumerate(heads) if head.text.startswith(text)]
    browser.execute_script("arguments[0].click()", heads[index])
    return int(index)


def test_it_loads_without_a_network_and_without_complaints(browser: Any) -> None:
    assert browser.title.startswith("Rooms & co")
    assert browser.get_log("browser") == []
    script = "return [...document.images].filter(i => i.src).map(i => i.naturalWidth)"
    widths = browser.execute_script(script)
    assert len(widths) > 5
    assert min(widths) > 0
    resources = "return performance.getEntriesByType('resource').map(entry => entry.name)"
    assert not [name for name in browser.execute_script(resources) if not name.startswith("data:")]


def test_a_name_is_shown_and_does_not_run(browser: Any) -> None:
    assert EVIL in browser.find_element("css selector", "#all").text
    assert len(browser.find_elements("css selector", "script")) == 1


def test_the_policy_forbids_the_network(browser: Any) -> None:
    script = """
        const done = arguments[0];
        document.addEventListener("securitypolicyviolation", e => done(e.effectiveDirective));
        const image = new Image();
        image.src = "http://localhost:9/picture.png";
    """
    assert browser.execute_async_script(script) == "img-src"


def test_the_slider_moves_the_cut_by_keys(browser: Any) -> None:
    from selenium.webdriver.common.keys import Keys

    slider = browser.find_element("css selector", ".compare input")
    render = browser.find_element("css selector", ".compare .over")
    before = render.value_of_css_property("clip-path")
    slider.send_keys(Keys.ARROW_RIGHT * 5)
    after = render.value_of_css_property("clip-path")
    assert "50%" in before
    assert "55%" in after
    slider.send_keys(Keys.END)
    assert "100%" in render.value_of_css_property("clip-path")


def test_a_click_on_a_heading_sorts_by_number_and_again_reverses(browser: Any) -> None:
    index = click_head(browser, "inliers")
    texts = column(browser, index)
    numbers = [int(text) for text in texts if text.isdigit()]
    assert numbers == sorted(numbers)
    click_head(browser, "inliers")
    texts_again = column(browser, index)
    assert [int(text) for text in texts_again if text.isdigit()] == numbers[::-1]
    for some in (texts, texts_again):  # what has no number comes last both times
        assert [text.isdigit() for text in some] == sorted([t.isdigit() for t in some])[::-1]
    names = column(browser, click_head(browser, "photo"))
    assert [n for n in names if n.startswith("photo-")] == sorted(
        n for n in names if n.startswith("photo-")
    )


def test_numbers_do_not_sort_as_text(browser: Any) -> None:
    fill = """
        const rows = document.querySelectorAll("table.sortable tbody tr");
        ["9", "10", "-3", "1e-4", "\\u2013", "200"].forEach(
            (text, i) => { rows[i].cells[arguments[0]].textContent = text; });
    """
    index = click_head(browser, "inliers")
    browser.execute_script(fill, index)
    click_head(browser, "inliers")
    assert column(browser, index) == ["200", "10", "9", "1e-4", "-3", "\u2013"]
    click_head(browser, "inliers")
    assert column(browser, index) == ["-3", "1e-4", "9", "10", "200", "\u2013"]


def test_the_filter_leaves_what_was_asked_for(browser: Any) -> None:
    browser.find_element("css selector", "#filter").send_keys("black")
    rows = browser.find_elements("css selector", "table.sortable tbody tr")
    assert [row.text.split()[0] for row in rows if row.is_displayed()] == ["black.png"]


def test_a_picture_is_enlarged(browser: Any) -> None:
    from selenium.webdriver.common.keys import Keys

    button = browser.find_element("css selector", ".enlarge")
    button.send_keys(Keys.ENTER)
    dialog = browser.find_element("css selector", "dialog")
    assert dialog.is_displayed()
    source = button.find_element("css selector", "img").get_attribute("src")
    assert dialog.find_element("css selector", "img").get_attribute("src") == source
    dialog.send_keys(Keys.ESCAPE)
    assert not dialog.is_displayed()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_light_and_dark(browser: Any, scheme: str) -> None:
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    body = browser.find_element("css selector", "body")
    paper, ink = (
        sum(int(c) for c in body.value_of_css_property(p).strip("rgba()").split(",")[:3])
        for p in ("background-color", "color")
    )
    assert (paper > 600 and ink < 200) if scheme == "light" else (paper < 150 and ink > 500)


@pytest.mark.parametrize("width", [400, 1400])
def test_labels_of_plots_are_not_cut(browser: Any, page: Path, width: int) -> None:
    """At either width, which set two sizes of letters: small errors end with a label as long as
    0.0002, half of which lies right of its tick."""
    browser.get(page.with_name("small.html").as_uri())
    size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        script = """
            return [...document.querySelectorAll("svg.plot text")].map(text => {
                const inner = text.getBoundingClientRect();
                const outer = text.closest("svg").getBoundingClientRect();
                return [inner.left - outer.left, inner.top - outer.top,
                        outer.right - inner.right, outer.bottom - inner.bottom];
            });
        """
        spaces = browser.execute_script(script)
        assert len(spaces) > 15
        assert "0.0002" in [e.text for e in browser.find_elements("css selector", ".plot text")]
        assert min(map(min, spaces)) >= 0
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_nothing_sticks_out_on_a_phone(browser: Any) -> None:
    size = {"width": 400, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        script = "return [document.documentElement.scrollWidth, innerWidth]"
        assert browser.execute_script(script) == [400, 400]
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
