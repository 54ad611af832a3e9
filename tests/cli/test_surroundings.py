# SPDX-License-Identifier: Apache-2.0
"""What surrounds a command: streams, signals, memory, homes, packages that have no wheel."""

from __future__ import annotations

import errno
import importlib.util
import io
import logging
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Callable

import numba
import numpy as np
import pytest
from helpers import write_splat
from scenes import room_map

from gscpe.cli.main import main
from gscpe.errors import ModelError, RenderError
from gscpe.models import installed_files, models_folder
from gscpe.scene import open_map

POSE = "a.png 1 0 0 0 0 0 0\n"
needs_shell = pytest.mark.skipif(os.name != "posix", reason="there is no POSIX shell")
needs_numba = pytest.mark.skipif(
    importlib.util.find_spec("numba") is None, reason="Numba is not installed (extra: cpu)"
)


@pytest.fixture
def poses(tmp_path: Path) -> str:
    (tmp_path / "poses.txt").write_text(POSE)
    return str(tmp_path / "poses.txt")


@pytest.fixture
def build_map(tmp_path: Path) -> list[str]:
    """A command that writes ``öut.gsmap``."""
    write_splat(tmp_path / "splat.ply", room_map().scene)
    output = str(tmp_path / "\u00f6ut.gsmap")
    return ["build-map", str(tmp_path / "splat.ply"), "--no-references", "--output", output]


@needs_shell
def test_closed_descriptors(build_map: list[str], poses: str) -> None:
    """What is printed goes nowhere, and above all not into the files that are written."""
    command = [sys.executable, "-m", "gscpe"]
    closed = ["sh", "-c", '"$@" <&- >&- 2>&-', "sh", *command]
    assert subprocess.run([*closed, *build_map], check=False).returncode == 0
    assert len(open_map(build_map[-1]).scene) == len(room_map().scene)
    assert subprocess.run([*closed, "evaluate", "nowhere", poses], check=False).returncode == 2


@pytest.mark.parametrize("closed", [True, False])
def test_no_streams(
    closed: bool, build_map: list[str], poses: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As under pythonw, or where a service closed them."""
    for name in ("stdout", "stderr"):
        stream = io.StringIO()
        stream.close()
        monkeypatch.setattr(sys, name, stream if closed else None)
    assert main(["evaluate", poses, poses]) == 0
    assert main(["evaluate", "nowhere", poses]) == 2
    assert main(build_map) == 0
    with pytest.raises(SystemExit) as caught:
        main(["evaluate"])
    assert caught.value.code == 2
    assert (sys.stdout is None) != closed  # they are as they were
    logging.getLogger("gscpe").warning("nobody hears this")


def test_a_terminal_of_another_encoding(
    build_map: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", terminal)
    assert main(build_map) == 0
    assert b"\\xf6ut.gsmap: " in terminal.buffer.getvalue()
    assert terminal.errors == "strict"


def raise_array_error() -> None:
    np.empty(2**58)


def raise_system_error() -> None:
    raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))


def raise_typed_error() -> None:
    raise RenderError("there is not enough memory to render") from MemoryError()


def raise_thread_error() -> None:
    raise RuntimeError("can't start new thread")


@pytest.mark.parametrize(
    "fail", [raise_array_error, raise_system_error, raise_typed_error, raise_thread_error]
)
def test_out_of_memory(
    fail: Callable[[], None],
    build_map: list[str],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("gscpe.cli.build_map.read_splat", lambda _: fail())
    assert main(build_map) == 3
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith("gscpe build-map: out of memory (")
    assert "fewer workers" in line


@needs_shell
@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_ended_from_outside(
    number: signal.Signals,
    status: int,
    build_map: list[str],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Like Ctrl-C, and nothing is left behind."""

    def end(*_: object) -> None:
        signal.raise_signal(number)

    monkeypatch.setattr("gscpe.scene.map_folder.to_contents", end)
    before = signal.signal(number, signal.SIG_DFL)
    try:
        assert main(build_map) == status
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, before)
    assert capsys.readouterr().err == f"gscpe build-map: ended by {number.name}\n"
    assert [entry.name for entry in Path(build_map[-1]).parent.iterdir()] == ["splat.ply"]


def no_home(monkeypatch: pytest.MonkeyPatch) -> None:
    """As for a user id that the system does not know, without HOME."""
    monkeypatch.delenv("HOME", raising=False)
    for name in ("XDG_CACHE_HOME", "GSCPE_MODELS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)


@needs_shell
def test_without_a_home(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """There are no trained networks then, and the reason is told."""
    no_home(monkeypatch)
    assert {file.state for file in installed_files()} == {"missing"}
    for chosen in ("", "~/models"):
        monkeypatch.setenv("GSCPE_MODELS", chosen)
        with pytest.raises(ModelError, match=r"has no home.*GSCPE_MODELS"):
            models_folder()
    for arguments, status in ((["models", "list"], 2), (["doctor"], 0)):
        assert main(arguments) == status
        out, err = capsys.readouterr()
        assert "this user has no home" in out + err


@needs_numba
def test_where_compiled_loops_are_kept(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither beside the package nor in a home: in the temporary folder, or nowhere where
    another user could have put something there."""
    from numba.core import caching

    from gscpe.render import compiled

    config: Any = numba.config

    for locator in ("InTreeCacheLocator", "UserWideCacheLocator"):
        monkeypatch.setattr(getattr(caching, locator), "from_function", lambda *_: None)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(config, "CACHE_DIR", "")
    has_place: Any = compiled._has_place.__wrapped__
    with caplog.at_level(logging.WARNING):
        assert has_place()
    (folder,) = tmp_path.iterdir()
    assert str(folder) == config.CACHE_DIR
    assert f"CPU rasterizer in {folder}" in caplog.text
    if hasattr(os, "getuid"):
        assert folder.stat().st_mode & 0o777 == 0o700
        folder.chmod(0o777)
        caplog.clear()
        monkeypatch.setattr(config, "CACHE_DIR", "")
        with caplog.at_level(logging.WARNING):
            assert not has_place()
        (record,) = caplog.records
        assert "each process compiles the CPU rasterizer again" in record.getMessage()


@needs_numba
@needs_shell
def test_without_a_home_no_folder_of_the_name_of_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba alone would make a folder "~" wherever the user is."""
    from gscpe.render import compiled

    config: Any = numba.config

    no_home(monkeypatch)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(config, "CACHE_DIR", "")
    has_place: Any = compiled._has_place.__wrapped__
    assert has_place()
    assert config.CACHE_DIR.startswith(str(tmp_path / "gscpe-numba-"))
    assert list((tmp_path / "here").iterdir()) == []


WITHOUT_MODERNGL = """
import sys
sys.modules["moderngl"] = None  # as where it is not installed
import numpy as np
from gscpe import Camera, GscpeError, Renderer
from gscpe.cli.doctor import tiny_scene
from gscpe.cli.main import main
with Renderer(tiny_scene()) as renderer:
    view = renderer.render(Camera.pinhole(64, 48, fx=60, fy=60, cx=32, cy=24), np.eye(4))
assert view.opacity.max() > 0.5
print(renderer.description)
try:
    Renderer(tiny_scene(), "gl")
except GscpeError as error:
    print(error)
sys.exit(main(["doctor"]))
"""


@needs_numba
def test_without_moderngl_the_cpu_renders() -> None:
    """It has no wheel for Arm Linux."""
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_MODERNGL], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("CPU rasterizer")
    assert lines[1].startswith("OpenGL needs moderngl, which is missing")
    assert "moderngl, which connects to OpenGL, is missing" in done.stdout
    assert lines[-1].startswith("everything works")
