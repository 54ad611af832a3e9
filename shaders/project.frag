#version 330 core
// SPDX-License-Identifier: Apache-2.0
// Stage 1: projects the visible Gaussians, one fragment a Gaussian. Writes textures that
// stage 2 reads by instance, so that the work is done once a Gaussian and not once a vertex.

uniform usampler2D order;          // visible Gaussians, back to front
uniform usampler2D visible_count;  // one texel
#include "projection.glsl"

layout(location = 0) out vec4 ellipse;
layout(location = 1) out vec4 extent;
layout(location = 2) out vec4 colour;

void main() {
    ivec2 cell = ivec2(gl_FragCoord.xy);
    int width = textureSize(order, 0).x;
    if (cell.y * width + cell.x >= int(texelFetch(visible_count, ivec2(0), 0).r)) {
        ellipse = extent = colour = vec4(0.0);
        return;
    }
    project(int(texelFetch(order, cell, 0).r), ellipse, extent, colour);
}
