# SPDX-License-Identifier: Apache-2.0
"""What a rasterizer offers, and which one fits the machine."""

from __future__ import annotations

from typing import Literal, Protocol

from gscpe.arrays import Float64Array
from gscpe.errors import RenderError, SettingsError
from gscpe.geometry.camera import Camera
from gscpe.render import cpu_rasterizer
from gscpe.render.context import driver_info
from gscpe.render.view import RenderedView

Backend = Literal["gl", "cpu"]


class Rasterizer(Protocol):
    """Holds one splat and renders it. Callers have checked the camera and the pose."""

    description: str

    def render(self, camera: Camera, cam_from_world: Float64Array) -> RenderedView:
        """The splat as a pinhole camera sees it."""
        ...

    def close(self) -> None:
        """Gives the memory back."""
        ...


def choose_backend(backend: str = "auto") -> Backend:
    """The rasterizer to use: ``"gl"`` or ``"cpu"``.

    ``"auto"`` takes OpenGL on a GPU; else the CPU rasterizer, where Numba is installed: it is
    several times faster than OpenGL in software; else OpenGL in software.

    Raises:
        SettingsError: another word was given.
        RenderError: there is neither OpenGL nor Numba.
    """
    if backend == "gl":
        return "gl"
    if backend == "cpu":
        return "cpu"
    if backend != "auto":
        raise SettingsError(f"backend must be auto, gl or cpu, not {backend!r}")
    cpu = cpu_rasterizer.is_available()
    try:
        software = driver_info().is_software
    except RenderError as error:
        if not cpu:
            raise RenderError(f"{error}; or, without OpenGL: pip install 'gscpe[cpu]'") from error
        return "cpu"
    return "cpu" if software and cpu else "gl"
