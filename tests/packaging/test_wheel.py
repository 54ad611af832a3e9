"""What pip installs: the package with its shaders, and nothing of the tests."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_wheel_holds_all_that_runs(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", str(tmp_path), str(ROOT)], check=True)
    (wheel,) = tmp_path.glob("gscpe-*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    for shader in (ROOT / "shaders").iterdir():
        assert f"gscpe/shaders/{shader.name}" in names
    for module in (ROOT / "gscpe").rglob("*.py"):
        assert str(module.relative_to(ROOT)) in names
    page = {f"gscpe/report/page.{kind}" for kind in ("html.jinja", "css", "js")}
    assert {"gscpe/py.typed", *page} <= names
    assert not [name for name in names if name.startswith(("tests", "tools", "examples"))]
