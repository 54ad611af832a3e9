#version 330 core
// SPDX-License-Identifier: Apache-2.0
// Stage 2: one quad an instance, from what stage 1 has found.

uniform sampler2D ellipses;
uniform sampler2D extents;
uniform sampler2D colours;
#include "quad.glsl"

void main() {
    int width = textureSize(ellipses, 0).x;
    ivec2 cell = ivec2(gl_InstanceID % width, gl_InstanceID / width);
    put_corner(texelFetch(ellipses, cell, 0), texelFetch(extents, cell, 0),
               texelFetch(colours, cell, 0).rgb);
}
