# SPDX-License-Identifier: Apache-2.0
"""A real browser, for the tests of pages: tools/test --full installs what they need."""

from __future__ import annotations

import importlib.util
import shutil
from contextlib import contextmanager
from typing import Any, Iterator, Mapping

import pytest

PATIENCE = 120.0
"""Seconds; a loaded machine renders a frame in some of them."""

_BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
_DRIVER = shutil.which("chromedriver")


def needs_browser(*packages: str) -> list[pytest.MarkDecorator]:
    """Marks of tests that need Chromium, and these packages."""
    missing = [name for name in ("selenium", *packages) if importlib.util.find_spec(name) is None]
    return [
        pytest.mark.skipif(_BROWSER is None or _DRIVER is None, reason="Chromium is not installed"),
        pytest.mark.skipif(bool(missing), reason=f"{', '.join(missing)} not installed"),
    ]


@contextmanager
def chromium(*options: str, phone: Mapping[str, Any] | None = None) -> Iterator[Any]:
    """A headless Chromium, as selenium drives it.

    Args:
        options: of its command line.
        phone: that it pretends to be.
    """
    from selenium import webdriver

    settings = webdriver.ChromeOptions()
    settings.binary_location = str(_BROWSER)
    for option in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", *options):
        settings.add_argument(option)
    if phone is not None:
        settings.add_experimental_option("mobileEmulation", {"deviceMetrics": dict(phone)})
    settings.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=settings, service=webdriver.ChromeService(str(_DRIVER)))
    try:
        driver.set_page_load_timeout(PATIENCE)
        driver.set_script_timeout(PATIENCE)
        yield driver
    finally:
        driver.quit()
