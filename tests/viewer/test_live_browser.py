# SPDX-License-Identifier: Apache-2.0
"""The page that grows, in a real browser."""

from __future__ import annotations

from typing import Any, Iterator

import pytest
from browser import needs_browser
from scenes import room_map
from viewing import complaints, detail, near, picture, step, viewing_chromium, wait_until

from gscpe.viewer import Live
from gscpe.viewer.cameras import COLOURS, TRAJECTORY

pytestmark = needs_browser("viser")


@pytest.fixture(scope="module")
def live() -> Iterator[Live]:
    with Live(room_map(), name="room", most_gaussians=2000) as live:
        yield live


@pytest.fixture(scope="module")
def chromium(live: Live) -> Iterator[Any]:
    with viewing_chromium() as driver:
        driver.get(live.viewer.url)
        wait_until(lambda: "Waiting for what is found" in text(driver))
        yield driver


def text(chromium: Any) -> str:
    """All of the page."""
    return str(chromium.execute_script("return document.body.innerText"))


def test_it_grows_before_ones_eyes(live: Live, chromium: Any) -> None:
    assert near(picture(chromium), COLOURS["final"]) < 5
    assert "Not localized" not in text(chromium)
    live.add_detail(detail("a.png", True))
    wait_until(lambda: near(picture(chromium), COLOURS["final"]) > 20)
    wait_until(lambda: "1 of 1 photos localized so far" in text(chromium))
    live.add_detail(detail("b.png", False))
    wait_until(lambda: "Not localized (1)" in text(chromium))
    assert "too few matches" in text(chromium)
    assert near(picture(chromium), TRAJECTORY) < 5
    for number in range(6):
        live.add(*step(number))
    wait_until(lambda: near(picture(chromium), TRAJECTORY) > 20)
    first = near(picture(chromium), TRAJECTORY)
    for number in range(6, 30):
        live.add(*step(number))
    live.finish()
    wait_until(lambda: "Finished" in text(chromium))
    wait_until(lambda: near(picture(chromium), TRAJECTORY) != first)
    assert "frame 27: it is dark" in text(chromium)


def test_the_browser_has_no_complaints(live: Live, chromium: Any) -> None:
    assert complaints(chromium) == []
