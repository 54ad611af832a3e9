# SPDX-License-Identifier: Apache-2.0
"""Fixtures that the whole suite shares; plain helper functions are in helpers.py."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from types import ModuleType
from typing import Callable

import numpy as np
import pytest
from hypothesis import settings

pytest_plugins = ("service_fixtures", "tracking_fixtures")

# Reproducible, and no failure because a shared machine was slow for a moment.
settings.register_profile("gscpe", deadline=None, derandomize=True, database=None, max_examples=50)
settings.load_profile("gscpe")


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that starts alike in every test."""
    return np.random.default_rng(20240607)


@pytest.fixture(scope="session")
def kitchen() -> Path:
    """The RedKitchen folder, for tests on real photos."""
    root = os.environ.get("GSCPE_DATA")
    if not root:
        pytest.skip("set GSCPE_DATA to the folder that holds redkitchen/ to run this")
    folder = Path(root) / "redkitchen"
    assert folder.is_dir(), f"GSCPE_DATA is set, but {folder} is missing"
    return folder


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Imports a tool by name."""
    tools = Path(__file__).resolve().parents[1] / "tools"
    if not tools.is_dir():
        pytest.skip("there are no tools beside the tests")
    monkeypatch.syspath_prepend(str(tools))
    return importlib.import_module


@pytest.fixture(params=["gl", "cpu"])
def backend(request: pytest.FixtureRequest) -> str:
    """Every rasterizer must pass the tests that take this."""
    return str(request.param)
