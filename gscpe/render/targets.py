# SPDX-License-Identifier: Apache-2.0
"""The textures that the stages write to and read from."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import Float32Array
from gscpe.errors import RenderError
from gscpe.render.context import check_errors

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
    return _texture(context, (width, height), components, "f4", padded)


def _texture(
    context: moderngl.Context,
    size: tuple[int, int],
    components: int,
    dtype: str,
    texels: Float32Array | None = None,
) -> moderngl.Texture:
    texture = context.texture(size, components, texels, dtype=dtype)
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    try:
        # A driver without memory for it reports so, and hands out a texture all the same.
        check_errors(context, f"allocating a texture of {size[0]}x{size[1]}")
    except RenderError:
        texture.release()
        raise
    return texture


class ProjectionTargets:
    """The draw order and, in that order, what stage 1 found out about each Gaussian."""

    def __init__(self, context: moderngl.Context, capacity: int) -> None:
        self._rows = -(-capacity // _ORDER_WIDTH)
        size = (_ORDER_WIDTH, self._rows)
        self._owned: list[Any] = []
        try:
            self.order = self._own(_texture(context, size, 1, "u4"))
            self.visible_count = self._own(_texture(context, (1, 1), 1, "u4"))
            self.textures = [self._own(_texture(context, size, 4, "f4")) for _ in range(3)]
            self._framebuffer = self._own(context.framebuffer(self.textures))
        except BaseException:
            self.release()
            raise

    def _own(self, resource: Any) -> Any:
        self._owned.append(resource)
        return resource

    def write_order(self, order: NDArray[np.uint32]) -> None:
        self.visible_count.write(np.array([len(order)], dtype=np.uint32))
        rows = -(-len(order) // _ORDER_WIDTH)
        if rows:
            padded = np.zeros(rows * _ORDER_WIDTH, dtype=np.uint32)
            padded[: len(order)] = order
            self.order.write(padded, viewport=(0, 0, _ORDER_WIDTH, rows))

    def read_order(self) -> NDArray[np.uint32]:
        """The draw order, (M,) uint32; waits for the driver. For tests."""
        (count,) = np.frombuffer(self.visible_count.read(), dtype=np.uint32)
        return np.frombuffer(self.order.read(), dtype=np.uint32)[:count]

    def use(self, count: int | None) -> None:
        """Makes this the target, limited to the rows that ``count`` Gaussians need; all rows
        where only the GPU knows how many there are."""
        rows = self._rows if count is None else max(1, -(-count // _ORDER_WIDTH))
        self._framebuffer.use()
        self._framebuffer.viewport = (0, 0, _ORDER_WIDTH, rows)

    def release(self) -> None:
        for resource in reversed(self._owned):
            resource.release()
        self._owned.clear()


class ImageTargets:
    """Colour with opacity, and two depth moments, in single precision.

    Blending takes the opacity from the shader, so the moments need no fourth channel.
    """

    _CHANNELS = (4, 2)

    def __init__(self, context: moderngl.Context, width: int, height: int) -> None:
        self.size = (width, height)
        self._textures: list[moderngl.Texture] = []
        self._framebuffer: moderngl.Framebuffer | None = None
        try:
            for channels in self._CHANNELS:
                self._textures.append(_texture(context, self.size, channels, "f4"))
            self._framebuffer = context.framebuffer(self._textures)
        except BaseException:
            self.release()
            raise

    def clear_and_use(self) -> None:
        assert self._framebuffer is not None
        self._framebuffer.use()
        self._framebuffer.viewport = (0, 0, *self.size)
        self._framebuffer.clear()

    def read(self) -> tuple[Float32Array, Float32Array]:
        """Colour with opacity, (H, W, 4), and the moments, (H, W, 2)."""
        colour, moments = (self._read(i, channels) for i, channels in enumerate(self._CHANNELS))
        return colour, moments

    def _read(self, attachment: int, channels: int) -> Float32Array:
        assert self._framebuffer is not None
        width, height = self.size
        data: Any = self._framebuffer.read(components=channels, attachment=attachment, dtype="f4")
        return np.frombuffer(data, dtype=np.float32).reshape(height, width, channels)

    def release(self) -> None:
        if self._framebuffer is not None:
            self._framebuffer.release()
        for texture in self._textures:
            texture.release()
