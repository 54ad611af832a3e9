"""The textures that the stages write to and read from."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array
from gscpe.errors import RenderError

_ORDER_WIDTH = 1024
_DATA_WIDTH = 4096


def data_texture(context: moderngl.Context, texels: Float32Array) -> moderngl.Texture:
    """A float texture that holds (N, 1..4) texels row by row, for texelFetch.

    Raises:
        RenderError: the driver cannot hold a texture of this size.
    """
    limit = int(context.info["GL_MAX_TEXTURE_SIZE"])
    count, components = texels.shape
    width = min(_DATA_WIDTH if count <= _DATA_WIDTH * limit else limit, limit)
    height = -(-count // width)
    if height > limit:
        raise RenderError(f"the splat is too large for this driver ({count} texels)")
    padded = np.zeros((width * height, components), dtype=np.float32)
    padded[:count] = texels
    texture = context.texture((width, height), components, padded.tobytes(), dtype="f4")
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture


class ProjectionTargets:
    """The draw order and, in that order, what stage 1 found out about each Gaussian."""

    def __init__(self, context: moderngl.Context, capacity: int) -> None:
        self._rows = -(-capacity // _ORDER_WIDTH)
        size = (_ORDER_WIDTH, self._rows)
        self.order = context.texture(size, 1, dtype="u4")
        self.order.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.textures = [context.texture(size, 4, dtype="f4") for _ in range(3)]
        for texture in self.textures:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._framebuffer = context.framebuffer(self.textures)

    def write_order(self, order: NDArray[np.uint32]) -> None:
        rows = -(-len(order) // _ORDER_WIDTH)
        if rows:
            padded = np.zeros(rows * _ORDER_WIDTH, dtype=np.uint32)
            padded[: len(order)] = order
            self.order.write(padded, viewport=(0, 0, _ORDER_WIDTH, rows))

    def use(self, count: int) -> None:
        """Makes this the target, limited to the rows that ``count`` Gaussians need."""
        self._framebuffer.use()
        self._framebuffer.viewport = (0, 0, _ORDER_WIDTH, max(1, -(-count // _ORDER_WIDTH)))

    def release(self) -> None:
        self._framebuffer.release()
        for texture in (*self.textures, self.order):
            texture.release()


class ImageTargets:
    """Colour and depth moments in single precision."""

    def __init__(self, context: moderngl.Context, width: int, height: int) -> None:
        self.size = (width, height)
        self._textures = [context.texture(self.size, 4, dtype="f4") for _ in range(2)]
        self._framebuffer = context.framebuffer(self._textures)

    def clear_and_use(self) -> None:
        self._framebuffer.use()
        self._framebuffer.viewport = (0, 0, *self.size)
        self._framebuffer.clear()

    def read(self) -> tuple[Float32Array, Float32Array]:
        """Colour and moments, (H, W, 4) each."""
        colour, moments = (self._read(attachment) for attachment in range(2))
        return colour, moments

    def _read(self, attachment: int) -> Float32Array:
        data: Any = self._framebuffer.read(components=4, attachment=attachment, dtype="f4")
        width, height = self.size
        return np.frombuffer(data, dtype=np.float32).reshape(height, width, 4)

    def release(self) -> None:
        self._framebuffer.release()
        for texture in self._textures:
            texture.release()
