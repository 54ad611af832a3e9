# SPDX-License-Identifier: Apache-2.0
"""What pip installs: the package with its shaders, and nothing of the tests."""

from __future__ import annotations

import email
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import gscpe

ROOT = Path(__file__).resolve().parents[2]
HOME = "https://github.com/gscpe/gscpe"
RAW = "https://raw.githubusercontent.com/gscpe/gscpe/main/"


def test_the_wheel_holds_all_that_runs(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", str(tmp_path), str(ROOT)], check=True)
    (wheel,) = tmp_path.glob("gscpe-*.whl")
    assert wheel.name == f"gscpe-{gscpe.__version__}-py3-none-any.whl"
    archive = zipfile.ZipFile(wheel)
    names = set(archive.namelist())
    for shader in (ROOT / "shaders").iterdir():
        assert f"gscpe/shaders/{shader.name}" in names
    for module in (ROOT / "gscpe").rglob("*.py"):
        assert str(module.relative_to(ROOT)) in names
    page = {f"gscpe/report/page.{kind}" for kind in ("html.jinja", "css", "js")}
    assert {"gscpe/py.typed", *page} <= names
    assert not [name for name in names if name.startswith(("tests", "tools", "examples"))]
    folder = f"gscpe-{gscpe.__version__}.dist-info"
    assert {f"{folder}/licenses/LICENSE", f"{folder}/licenses/NOTICE"} <= names
    metadata = email.message_from_bytes(archive.read(f"{folder}/METADATA"))
    assert metadata["Version"] == gscpe.__version__
    urls = dict(line.split(", ") for line in metadata.get_all("Project-URL", []))
    assert urls["Homepage"] == HOME
    assert all(url.startswith(HOME) for url in urls.values())
    # A package index shows the README alone: its pictures must be reachable from anywhere.
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", str(metadata.get_payload()))
    assert pictures
    for picture in pictures:
        assert picture.startswith(RAW)
        assert (ROOT / picture.removeprefix(RAW)).is_file()


def test_the_version_stands_in_one_place() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert "version" not in project
    assert project["dynamic"] == ["version"]
    assert f"## {gscpe.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_addresses_of_the_project_agree() -> None:
    found = []
    for name in ("README.md", "CONTRIBUTING.md", "NOTICE", "CHANGELOG.md", "pyproject.toml"):
        text = (ROOT / name).read_text()
        found += re.findall(
            r"https://(?:raw\.githubusercontent|github)\.com/[\w-]*gscpe/[\w-]+", text
        )
    assert found
    assert {address.rsplit(".com/", 1)[1] for address in found} == {"gscpe/gscpe"}
