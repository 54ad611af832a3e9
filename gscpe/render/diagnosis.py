# SPDX-License-Identifier: Apache-2.0
"""Why there is no OpenGL, or only slow OpenGL, and what to do: pure functions of facts."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Mapping

MESA = (
    "install the system libraries for off-screen OpenGL (Debian, Ubuntu: apt-get install "
    "libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri; Fedora: dnf install libglvnd-egl libglvnd-glx "
    "mesa-libEGL mesa-libGL mesa-dri-drivers)"
)
_UPDATE = (
    "update the graphics driver (Debian, Ubuntu: apt-get install --only-upgrade libgl1-mesa-dri; "
    "Fedora: dnf upgrade mesa-dri-drivers; NVIDIA: version 390 or later)"
)
_NATIVE = "install or update the graphics driver"

VARIABLES = (
    *("LIBGL_ALWAYS_SOFTWARE", "LIBGL_DRIVERS_PATH", "GALLIUM_DRIVER", "EGL_PLATFORM"),
    *("MESA_GL_VERSION_OVERRIDE", "MESA_LOADER_DRIVER_OVERRIDE"),
    *("__EGL_VENDOR_LIBRARY_FILENAMES", "__EGL_VENDOR_LIBRARY_DIRS"),
    *("GLCONTEXT_DEVICE_INDEX", "GLCONTEXT_GLVERSION"),
    *("GLCONTEXT_LINUX_LIBGL", "GLCONTEXT_LINUX_LIBEGL", "GLCONTEXT_LINUX_LIBX11"),
)
"""Environment variables that decide which driver is found."""

# What the attempts to make a context report: a pattern, what it means, what to do. 0x3001 is
# EGL_NOT_INITIALIZED, 0x3009 EGL_BAD_MATCH.
_ERRORS = (
    (
        r"needs moderngl",
        "moderngl, which connects to OpenGL, is missing; the CPU rasterizer does not need it "
        "(moderngl has no wheel for Arm Linux)",
        "pip install moderngl (on Arm Linux this compiles it: a C++ compiler is needed)",
    ),
    (r"libEGL\S* not loaded", "libEGL is missing; contexts without a window need it", MESA),
    (r"libGL\b\S* not loaded", "libGL is missing", MESA),
    (r"eglQueryDevicesEXT not found", "libEGL is too old to list its devices", _UPDATE),
    (r"found 0 devices", "libEGL finds no driver, neither Mesa's nor a GPU maker's", MESA),
    (r"eglInitialize failed", "EGL found a device, but no driver that starts on it", MESA),
    (
        r"eglCreateContext failed|too old|Requested OpenGL version",
        "the driver is too old: it does not have OpenGL 3.3 (core profile)",
        _UPDATE,
    ),
    (r"eglChooseConfig failed", "the EGL driver offers OpenGL ES only", _UPDATE),
    (
        r"XOpenDisplay",
        "DISPLAY is set, but no X server can be reached",
        "unset DISPLAY; rendering needs no display where EGL works",
    ),
)


@dataclass(frozen=True)
class ContextFailure:
    """A way to make a context that failed, such as ``EGL device 0``, and what it reported."""

    way: str
    error: str


@dataclass(frozen=True)
class OpenGLFacts:
    """What the machine shows.

    Attributes:
        platform: ``sys.platform``.
        failures: in the order in which they were tried.
        renderer: the driver's name, or None where no way worked.
        is_software: whether that driver runs on the CPU.
        device_nodes: ``/dev/dri/renderD*`` by name: whether this user may read and write it.
        has_nvidia: NVIDIA's kernel driver is loaded.
        has_numba: the CPU rasterizer can run.
        variables: those of VARIABLES that are set.
    """

    platform: str = "linux"
    failures: tuple[ContextFailure, ...] = ()
    renderer: str | None = None
    is_software: bool = False
    device_nodes: Mapping[str, bool] = field(default_factory=dict)
    has_nvidia: bool = False
    has_numba: bool = True
    variables: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Finding:
    """One thing that is not as it should be, and what to do about it."""

    problem: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.problem}: {self.remedy}"


def findings(facts: OpenGLFacts) -> list[Finding]:
    """What stands between this machine and OpenGL on a GPU; empty where nothing does."""
    found: list[Finding] = []
    if facts.renderer is None or facts.failures:
        found += _why_nothing(facts)
    if facts.renderer is None or facts.is_software:
        found += _why_no_gpu(facts)
    if facts.variables and (facts.renderer is None or facts.is_software or facts.failures):
        values = ", ".join(f"{name}={value}" for name, value in facts.variables.items())
        found.append(
            Finding(f"these environment variables choose the driver: {values}", "try without them")
        )
    if facts.is_software and not facts.has_numba:
        found.append(
            Finding(
                "OpenGL runs on the CPU, where gscpe's own CPU rasterizer is several times faster",
                "pip install 'gscpe[cpu]'",
            )
        )
    return list(dict.fromkeys(found))


def _why_nothing(facts: OpenGLFacts) -> list[Finding]:
    if facts.platform != "linux":
        return [Finding("no OpenGL 3.3 context can be made", _NATIVE)]
    found = [
        Finding(problem, remedy)
        for attempt in facts.failures
        for pattern, problem, remedy in _ERRORS
        if re.search(pattern, attempt.error)
    ]
    return found or [Finding("no OpenGL 3.3 context can be made", MESA)]


def _why_no_gpu(facts: OpenGLFacts) -> list[Finding]:
    if facts.platform != "linux":
        return []
    closed = [name for name, usable in facts.device_nodes.items() if not usable]
    if closed:
        return [
            Finding(
                f"this user has no permission to open {', '.join(closed)}",
                "sudo usermod -aG render,video $USER, then log in again; in a container, "
                "add the group that owns the device (docker run --group-add)",
            )
        ]
    if facts.has_nvidia:
        return [
            Finding(
                "there is an NVIDIA GPU, but not its OpenGL libraries",
                "install them (Debian: apt-get install nvidia-egl-icd; "
                "Ubuntu: libnvidia-gl-VERSION of the driver's version; Fedora, RPM Fusion: "
                "dnf install xorg-x11-drv-nvidia-libs); in a container, set "
                "NVIDIA_DRIVER_CAPABILITIES=all (docker run --gpus all -e ...)",
            )
        ]
    if facts.device_nodes:
        return [
            Finding(
                f"there is a GPU ({', '.join(facts.device_nodes)}), but no driver that uses it",
                "install it (Debian, Ubuntu: apt-get install libgl1-mesa-dri; Fedora: dnf install "
                "mesa-dri-drivers)",
            )
        ]
    return [
        Finding(
            "no GPU was found (there is no /dev/dri and no NVIDIA driver)",
            "ignore this if the machine has none; in a container, pass it through (docker run "
            "--device /dev/dri, or --gpus all)",
        )
    ]


def summary(facts: OpenGLFacts) -> str:
    """One line for an error message: what failed, and the remedies."""
    tried = "; ".join(f"{attempt.way}: {attempt.error}" for attempt in facts.failures)
    remedies = dict.fromkeys(finding.remedy for finding in _why_nothing(facts))
    return (
        f"no off-screen OpenGL 3.3 context ({tried}); {'; '.join(remedies)}; "
        "gscpe doctor explains more"
    )
