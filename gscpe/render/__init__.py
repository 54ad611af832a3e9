"""Off-screen OpenGL rendering of splats. No GL object leaves this room."""

from gscpe.render.context import DriverInfo, driver_info
from gscpe.render.renderer import Renderer
from gscpe.render.view import RenderedView

__all__ = ["DriverInfo", "RenderedView", "Renderer", "driver_info"]
