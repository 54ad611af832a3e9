# SPDX-License-Identifier: Apache-2.0
"""Creates off-screen OpenGL contexts, and finds out what stands in the way of one."""

from __future__ import annotations

import functools
import importlib.util
import logging
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Callable, Iterator

from gscpe.errors import RenderError
from gscpe.render.diagnosis import VARIABLES, ContextFailure, OpenGLFacts, summary
from gscpe.render.osmesa import OSMesaContext
from gscpe.render.own_thread import in_own_thread

if TYPE_CHECKING:
    import moderngl

REQUIRED_GL = 330
COMPUTE_GL = 430

# The names with a version are there without the development packages.
_EGL: dict[str, Any] = {"backend": "egl", "libgl": "libGL.so.1", "libegl": "libEGL.so.1"}
_X11: dict[str, Any] = {"libgl": "libGL.so.1", "libx11": "libX11.so.6"}
_EGL_DEVICES = 16
_SOFTWARE = (
    *("llvmpipe", "softpipe", "swrast", "swr ", "lavapipe", "swiftshader"),
    *("software", "gdi generic", "basic render"),
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DriverInfo:
    """The OpenGL driver: its names, its version as 330 for 3.3, whether it is a CPU, and
    through which library it was reached."""

    renderer: str
    vendor: str
    version: str
    version_code: int
    is_software: bool
    reached_by: str = ""


def import_moderngl() -> ModuleType:
    """moderngl, which has no wheel for Arm Linux, so that a machine may do without it.

    Raises:
        RenderError: it is not installed, or cannot be loaded.
    """
    try:
        import moderngl
    except ImportError as error:
        raise RenderError(
            f"OpenGL needs moderngl, which is missing ({error}): pip install moderngl; or render "
            "on the CPU: pip install 'gscpe[cpu]'"
        ) from error
    return moderngl


def create_context() -> moderngl.Context:
    """A new off-screen context with OpenGL 3.3 or later.

    On Linux: from the first EGL device that works, else from the X server of DISPLAY, else from
    libOSMesa; elsewhere the system's own.

    Raises:
        RenderError: there is no such context to be had; the message says what to install. Or
            this process was forked from one that has used OpenGL.
    """
    check_process(_first_process())
    import_moderngl()
    context, failures = _first_context()
    if context is None:
        raise RenderError(summary(OpenGLFacts(platform=sys.platform, failures=failures)))
    if context.version_code < REQUIRED_GL:
        found = context.info["GL_VERSION"]
        context.release()
        raise RenderError(f"the OpenGL driver is too old: {found}, 3.3 is needed; update it")
    if failures:
        tried = "; ".join(f"{attempt.way}: {attempt.error}" for attempt in failures)
        _log.warning(
            "using OpenGL through %s, because other ways failed (%s)", context.extra, tried
        )
    return context


@functools.cache
def _first_process() -> int:
    """The process in which OpenGL was first used; a forked one remembers its parent's."""
    return os.getpid()


def check_process(owner: int) -> None:
    """Refuses to go on in a fork: a driver's threads and device handles stay behind in the
    parent, and calls wait for them for ever.

    Args:
        owner: the process that made the context or, before the first one, this one.

    Raises:
        RenderError: this process is a fork of the owner.
    """
    if os.getpid() != owner:
        raise RenderError(
            "OpenGL was used before this process was forked, and does not survive that; start "
            "processes with multiprocessing.get_context('spawn'), or use backend='cpu'"
        )


def _first_context() -> tuple[moderngl.Context | None, tuple[ContextFailure, ...]]:
    """The first context that can be had, and what failed before."""
    failures: list[ContextFailure] = []
    no_more_egl = False
    try:
        import_moderngl()
    except RenderError as error:
        return None, (ContextFailure("moderngl", str(error)),)
    for way, options in _ways():
        if no_more_egl and way.startswith("EGL"):
            continue
        try:
            context = _newest(options)
        except Exception as error:  # moderngl and glcontext raise plain Exception
            text = str(error)
            # An error about the list of devices, or the library, holds for all of them.
            no_more_egl = "device index" in text or "not loaded" in text or "not found" in text
            if not ("device index" in text and failures):
                failures.append(ContextFailure(way, text))
            continue
        context.extra = way
        return context, tuple(failures)
    return None, tuple(failures)


def _newest(options: Callable[[], dict[str, Any]]) -> moderngl.Context:
    """A context with compute shaders, else one of 3.3. They must be asked for: Mesa gives the
    newest version that it has, NVIDIA's driver the very one that was asked for."""
    create: Callable[..., moderngl.Context] = import_moderngl().create_context
    try:
        return create(standalone=True, require=COMPUTE_GL, **options())
    except Exception:  # whatever it is, asking for less will tell
        return create(standalone=True, require=REQUIRED_GL, **options())


def _ways() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """Ways to make a context, with the options that moderngl needs, best first."""
    if not sys.platform.startswith("linux"):
        yield "the system", dict
        return
    chosen = os.environ.get("GLCONTEXT_DEVICE_INDEX")  # glcontext reads it
    for index in range(1 if chosen else _EGL_DEVICES):
        yield (
            f"EGL device {chosen or index}",
            lambda index=index: _EGL | {"device_index": index},  # type: ignore[misc]
        )
    if os.environ.get("DISPLAY"):
        yield "X11", lambda: _X11
    yield "OSMesa", lambda: {"context": OSMesaContext()}


def opengl_facts() -> OpenGLFacts:
    """What there is on this machine, for :func:`gscpe.render.diagnosis.findings`.

    Raises:
        RenderError: this process was forked from one that has used OpenGL.
    """
    check_process(_first_process())
    return in_own_thread(_opengl_facts)


def _opengl_facts() -> OpenGLFacts:
    context, failures = _first_context()
    facts = OpenGLFacts(
        platform="linux" if sys.platform.startswith("linux") else sys.platform,
        failures=failures,
        device_nodes={
            str(node): os.access(node, os.R_OK | os.W_OK)
            for node in sorted(Path("/dev/dri").glob("renderD*"))
        },
        has_nvidia=Path("/proc/driver/nvidia/version").exists(),
        has_numba=importlib.util.find_spec("numba") is not None,
        variables={name: os.environ[name] for name in VARIABLES if name in os.environ},
    )
    if context is None:
        return facts
    with context:
        info = describe(context)
    context.release()
    if info.version_code < REQUIRED_GL:
        old = ContextFailure(info.reached_by, f"the driver is too old: {info.version}")
        return replace(facts, failures=(*failures, old))
    return replace(facts, renderer=info.renderer, is_software=info.is_software)


def describe(context: moderngl.Context) -> DriverInfo:
    """The driver behind a context."""
    renderer = str(context.info["GL_RENDERER"])
    software = any(name in renderer.lower() for name in _SOFTWARE)
    return DriverInfo(
        renderer=renderer,
        vendor=str(context.info["GL_VENDOR"]),
        version=str(context.info["GL_VERSION"]),
        version_code=int(context.version_code),
        is_software=software,
        reached_by=str(context.extra or ""),
    )


def driver_info() -> DriverInfo:
    """The driver that rendering would use.

    Raises:
        RenderError: as :func:`create_context`.
    """
    return in_own_thread(_driver_info)


def _driver_info() -> DriverInfo:
    context = create_context()
    try:
        with context:  # at the end it is not current any more, and can really be released
            return describe(context)
    finally:
        context.release()


def check_errors(context: moderngl.Context, doing: str) -> None:
    """Raises what OpenGL has reported since the last call.

    Raises:
        RenderError: with OpenGL's word for it and the driver's name.
    """
    error = str(context.error)
    if error == "GL_NO_ERROR":
        return
    remedy = "; render smaller images or a smaller splat" if error == "GL_OUT_OF_MEMORY" else ""
    raise RenderError(
        f"OpenGL reported {error} while {doing} ({context.info['GL_RENDERER']}){remedy}"
    )
