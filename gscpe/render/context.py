"""Creates off-screen OpenGL contexts, and says what is missing when that fails."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import moderngl

from gscpe.errors import RenderError

REQUIRED_GL = 330

# The names with a version are there without the development packages.
_EGL: dict[str, Any] = {"backend": "egl", "libgl": "libGL.so.1", "libegl": "libEGL.so.1"}

_REMEDY_LINUX = (
    "install the system libraries for off-screen OpenGL "
    "(Debian, Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri), then run: gscpe doctor"
)
_REMEDY_OTHER = "install or update the graphics driver, then run: gscpe doctor"


@dataclass(frozen=True)
class DriverInfo:
    """The OpenGL driver: its names, its version as 330 for 3.3, and whether it is a CPU."""

    renderer: str
    vendor: str
    version: str
    version_code: int
    is_software: bool


def create_context() -> moderngl.Context:
    """A new off-screen context with OpenGL 3.3 or later: EGL on Linux, native elsewhere.

    Raises:
        RenderError: there is no such context to be had; the message says what to install.
    """
    linux = sys.platform.startswith("linux")
    try:
        if linux:
            context = moderngl.create_context(standalone=True, **_EGL)
        else:
            context = moderngl.create_context(standalone=True)
    except Exception as error:  # moderngl raises plain Exception when a library is missing
        remedy = _REMEDY_LINUX if linux else _REMEDY_OTHER
        raise RenderError(f"no off-screen OpenGL 3.3 context ({error}); {remedy}") from error
    if context.version_code < REQUIRED_GL:
        found = context.info["GL_VERSION"]
        context.release()
        raise RenderError(f"the OpenGL driver is too old: {found}, 3.3 is needed; update it")
    return context


def describe(context: moderngl.Context) -> DriverInfo:
    """The driver behind a context."""
    renderer = str(context.info["GL_RENDERER"])
    software = any(name in renderer.lower() for name in ("llvmpipe", "softpipe", "swrast"))
    return DriverInfo(
        renderer=renderer,
        vendor=str(context.info["GL_VENDOR"]),
        version=str(context.info["GL_VERSION"]),
        version_code=int(context.version_code),
        is_software=software,
    )


def driver_info() -> DriverInfo:
    """The driver that rendering would use.

    Raises:
        RenderError: as :func:`create_context`.
    """
    context = create_context()
    try:
        return describe(context)
    finally:
        context.release()
