"""The plain way to draw a splat with OpenGL, which tools/bench_render.py compares with.

Sorted quads in one pass: every vertex projects its Gaussian anew, so four times a Gaussian. All
else, the sort, the shaders' arithmetic, the targets and the read-back, is gscpe's.
"""

from __future__ import annotations

from typing import Any

from gscpe import Camera, GaussianScene
from gscpe.arrays import Float64Array
from gscpe.render.gl_rasterizer import GlRasterizer
from gscpe.render.shader_source import shader_source, with_includes
from gscpe.render.targets import ImageTargets

_VERTEX_SHADER = """#version 330 core
uniform usampler2D order;  // visible Gaussians, back to front
#include "projection.glsl"
#include "quad.glsl"

void main() {
    int width = textureSize(order, 0).x;
    ivec2 cell = ivec2(gl_InstanceID % width, gl_InstanceID / width);
    vec4 ellipse, extent, colour;
    project(int(texelFetch(order, cell, 0).r), ellipse, extent, colour);
    put_corner(ellipse, extent, colour.rgb);
}
"""


class PlainQuads(GlRasterizer):
    """Renders as :class:`GlRasterizer` does, without its first pass."""

    def __init__(self, scene: GaussianScene) -> None:
        super().__init__(scene, gpu_sort=False)
        assert self._context is not None
        with self._context as context:
            self._splat_program = self._own(
                context.program(
                    vertex_shader=with_includes(_VERTEX_SHADER, {"SH_COUNT": scene.sh.shape[1]}),
                    fragment_shader=shader_source("splat.frag"),
                )
            )
            self._quads = self._own(context.vertex_array(self._splat_program, []))

    def _project(self, count: int | None, camera: Camera, cam_from_world: Float64Array) -> None:
        self._projection.order.use(0)
        self._gaussians.use(1)
        self._harmonics.use(2)
        values = self._projection_values(camera, cam_from_world)
        values |= {"order": 0, "image_size": (camera.width, camera.height)}
        for name, value in values.items():
            if name in self._splat_program:
                self._splat_program[name].value = value

    def _draw(self, context: Any, targets: ImageTargets, count: int | None, camera: Camera) -> None:
        targets.clear_and_use()
        self._draw_quads(context, count)
