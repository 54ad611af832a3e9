# SPDX-License-Identifier: Apache-2.0
"""Explanations of what stands in OpenGL's way, from made-up facts and from broken set-ups."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from helpers import random_scene, simple_camera

from gscpe.cli import doctor
from gscpe.cli.main import main
from gscpe.errors import RenderError
from gscpe.render import Renderer, osmesa
from gscpe.render.diagnosis import ContextFailure, OpenGLFacts, findings, summary
from gscpe.render.rasterizer import choose_backend

GPU = OpenGLFacts(renderer="Radeon", device_nodes={"/dev/dri/renderD128": True})
SOFTWARE = OpenGLFacts(renderer="llvmpipe", is_software=True)


def text_of(facts: OpenGLFacts) -> str:
    return "\n".join(map(str, findings(facts)))


def test_a_gpu_that_works_needs_no_word() -> None:
    assert findings(GPU) == []
    assert findings(replace(GPU, variables={"EGL_PLATFORM": "x11"})) == []


@pytest.mark.parametrize(
    ("error", "problem", "package"),
    [
        ("libEGL.so.1 not loaded", "libEGL is missing", "libegl1"),
        ("libGL.so.1 not loaded", "libGL is missing", "libgl1"),
        ("requested device index 0, but found 0 devices", "finds no driver", "mesa-libEGL"),
        ("eglInitialize failed (0x3001)", "no driver that starts", "libgl1-mesa-dri"),
        ("eglCreateContext failed (0x3009)", "too old", "mesa-dri-drivers"),
        ("the driver is too old: 2.1 Mesa", "too old", "update the graphics driver"),
        ("eglChooseConfig failed (0x0)", "OpenGL ES only", "update"),
        ("(standalone) XOpenDisplay: cannot open display", "no X server", "unset DISPLAY"),
        ("something new", "no OpenGL 3.3 context", "apt-get install libegl1"),
    ],
)
def test_every_failure_is_explained(error: str, problem: str, package: str) -> None:
    facts = OpenGLFacts(failures=(ContextFailure("EGL device 0", error),))
    assert problem in text_of(facts)
    assert package in text_of(facts)
    assert error in summary(facts)
    assert package in summary(facts)
    assert "gscpe doctor" in summary(facts)


def test_a_failure_before_a_way_that_works_is_explained_too() -> None:
    failure = ContextFailure("EGL device 0", "libEGL.so.1 not loaded")
    assert "libEGL is missing" in text_of(replace(SOFTWARE, failures=(failure,)))


def test_a_device_without_permission() -> None:
    facts = replace(SOFTWARE, device_nodes={"/dev/dri/renderD128": False})
    assert "no permission to open /dev/dri/renderD128" in text_of(facts)
    assert "usermod -aG render,video" in text_of(facts)


def test_a_gpu_without_its_driver() -> None:
    assert "no driver that uses it" in text_of(
        replace(SOFTWARE, device_nodes={"/dev/dri/renderD128": True})
    )
    assert "NVIDIA_DRIVER_CAPABILITIES" in text_of(replace(SOFTWARE, has_nvidia=True))


def test_no_gpu_at_all() -> None:
    assert "no GPU was found" in text_of(SOFTWARE)
    assert "pip install 'gscpe[cpu]'" not in text_of(SOFTWARE)
    assert "pip install 'gscpe[cpu]'" in text_of(replace(SOFTWARE, has_numba=False))


def test_variables_that_choose_a_driver_are_named() -> None:
    assert "LIBGL_ALWAYS_SOFTWARE=1" in text_of(
        replace(SOFTWARE, variables={"LIBGL_ALWAYS_SOFTWARE": "1"})
    )


def test_elsewhere_the_remedy_is_the_driver() -> None:
    facts = OpenGLFacts(platform="win32", failures=(ContextFailure("the system", "no"),))
    assert "graphics driver" in text_of(facts)
    assert "apt-get" not in text_of(facts)


def no_osmesa() -> None:
    raise OSError("libOSMesa.so.8 not loaded")


def run_doctor(**variables: str) -> tuple[int, str]:
    """``gscpe doctor`` in a process of its own, without libOSMesa."""
    code = (
        "import sys\n"
        "from gscpe.render import osmesa\n"
        "osmesa._LIBRARIES = ('libnone.so',)\n"
        "from gscpe.cli.main import main\n"
        "sys.exit(main(['doctor']))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return done.returncode, done.stdout


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="libEGL is Linux's")
@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ({"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}, "libEGL finds no driver"),
        ({"GLCONTEXT_LINUX_LIBEGL": "libEGL-none.so"}, "libEGL is missing"),
    ],
)
def test_doctor_explains_a_broken_set_up(variables: dict[str, str], words: str) -> None:
    status, out = run_doctor(**variables)
    assert words in out
    assert next(iter(variables)) in out
    assert "rendering with gl                FAILED" in out
    works = "rendering with cpu               works" in out
    assert status == (0 if works else 1)


def test_doctor_fails_where_nothing_renders(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def nothing(*_: object) -> None:
        raise RenderError("no way")

    monkeypatch.setattr(doctor, "Renderer", nothing)
    monkeypatch.setattr(doctor, "choose_backend", nothing)
    assert main(["doctor"]) == 1
    assert "nothing to render with" in capsys.readouterr().out


def test_doctor_fails_where_the_pictures_disagree(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Darker(Renderer):
        def render(self, *arguments: object) -> object:  # type: ignore[override]
            view = super().render(*arguments)  # type: ignore[arg-type]
            return replace(view, rgb=0.9 * view.rgb) if "OpenGL" in self.description else view

    pytest.importorskip("numba")
    monkeypatch.setattr(doctor, "Renderer", Darker)
    assert main(["doctor"]) == 1
    assert "do they agree                    NO" in capsys.readouterr().out


def test_osmesa_renders_the_same(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    try:
        osmesa.OSMesaContext().release()
    except OSError as error:
        pytest.skip(str(error))
    scene = random_scene(rng, 300, 2)
    with Renderer(scene, "gl") as renderer:
        expected = renderer.render(simple_camera(), np.eye(4))
    monkeypatch.setenv("GLCONTEXT_LINUX_LIBEGL", "libEGL-none.so")
    monkeypatch.delenv("DISPLAY", raising=False)
    for _ in range(2):
        with Renderer(scene, "gl") as renderer:
            view = renderer.render(simple_camera(), np.eye(4))
    np.testing.assert_allclose(view.rgb, expected.rgb, atol=1 / 255)
    assert choose_backend("gl") == "gl"
