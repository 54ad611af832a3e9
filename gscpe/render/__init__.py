# SPDX-License-Identifier: Apache-2.0
"""Rendering of splats, with OpenGL off-screen or on the CPU. No GL object leaves this room."""

from gscpe.render.context import DriverInfo, driver_info
from gscpe.render.rasterizer import choose_backend
from gscpe.render.renderer import Renderer
from gscpe.render.similarity import correlation_map, local_correlation
from gscpe.render.view import RenderedView, Renders

__all__ = [
    "DriverInfo",
    "RenderedView",
    "Renderer",
    "Renders",
    "choose_backend",
    "correlation_map",
    "driver_info",
    "local_correlation",
]
