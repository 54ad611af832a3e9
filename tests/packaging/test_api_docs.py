# SPDX-License-Identifier: Apache-2.0
"""docs/api.md says what the docstrings say."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

import gscpe

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    path = ROOT / "tools" / "write_api_docs.py"
    spec = importlib.util.spec_from_file_location("write_api_docs", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_up_to_date(tool: ModuleType) -> None:
    written = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    assert written == tool.page(), "run python tools/write_api_docs.py"


def test_every_name_has_a_section_and_every_link_a_heading(tool: ModuleType) -> None:
    page = tool.page()
    headings = re.findall(r"^#{2,4} (\S+)$", page, flags=re.MULTILINE)
    assert set(gscpe.__all__) <= set(headings)
    anchors = {heading.replace(".", "").lower() for heading in headings}
    links = set(re.findall(r"\]\(#([^)]+)\)", page))
    assert links <= anchors
    assert ":class:" not in page and ":func:" not in page and ":meth:" not in page
    assert " at 0x" not in page


def test_signatures_are_whole(tool: ModuleType) -> None:
    page = tool.page()
    assert "save_map(map_: Map, folder: str | Path, *, compress: bool = False) -> None" in page
    assert "render(camera: Camera, cam_from_world: Float64Array) -> RenderedView" in page
    assert "    verification: VerificationSettings = VerificationSettings()," in page


def test_sections_of_docstrings_become_lists(tool: ModuleType) -> None:
    arguments = "Args:\n    a, b: one\n        and more.\n    c: see :class:`gscpe.Map`."
    text = f"Does it.\n\n{arguments}\n\nEnd."
    assert tool._markdown(text) == (
        "Does it.\n\n**Args**\n\n- `a, b`: one\n  and more.\n- `c`: see [`Map`](#map).\n\nEnd."
    )
