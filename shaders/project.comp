#version 430 core
// SPDX-License-Identifier: Apache-2.0
// Projects the visible Gaussians, nearest first, and finds the tiles that each touches.

layout(local_size_x = THREADS) in;
layout(std430, binding = 0) writeonly buffer Splats { vec4 splats[]; };  // 3 each
layout(std430, binding = 1) writeonly buffer Counts { uint counts[]; };  // of tiles, by workgroup
// Left and top tile, columns and rows, 16 bits each; tiles of those before in the workgroup.
layout(std430, binding = 2) writeonly buffer Touched { uvec4 touched[]; };
layout(std430, binding = 4) readonly buffer Draw {
    uint vertices, visible, first_vertex, base_instance;
};

uniform usampler2D order;  // farthest first
uniform vec2 image_size;
#include "projection.glsl"
#include "ellipse.glsl"
#include "workgroup_scan.glsl"

// Tiles of the pixel centres in the box around the ellipse; none: no columns.
uvec2 tiles_of(vec4 ellipse, vec4 extent, out uint count) {
    vec2 second = extent.x * normalize(vec2(-ellipse.w, ellipse.z));
    vec2 reach = extent.w * sqrt(ellipse.zw * ellipse.zw + second * second);
    vec2 low = max(ceil(ellipse.xy - reach - 0.5), 0.0);
    vec2 high = min(floor(ellipse.xy + reach - 0.5), image_size - 1.0);
    count = 0u;
    if (!(low.x <= high.x && low.y <= high.y)) return uvec2(0u);
    uvec2 first = uvec2(low) / uint(TILE);
    uvec2 sides = uvec2(high) / uint(TILE) - first + 1u;
    count = sides.x * sides.y;
    return uvec2(first.x | first.y << 16, sides.x | sides.y << 16);
}

void main() {
    uint place = gl_GlobalInvocationID.x, count = 0u;
    uvec2 tiles = uvec2(0u);
    if (place < visible) {
        uint slot = visible - 1u - place, width = uint(textureSize(order, 0).x);
        int g = int(texelFetch(order, ivec2(slot % width, slot / width), 0).r);
        vec4 ellipse, extent, colour;
        project(g, ellipse, extent, colour);
        if (extent.w > 0.0) {
            tiles = tiles_of(ellipse, extent, count);
            splats[3u * place] = vec4(ellipse.xy, extent.yz);
            splats[3u * place + 1u] = sigmas_from_pixels(ellipse, extent);
            splats[3u * place + 2u] = colour;
        }
    }
    uint total, before = sum_before(count, total);
    touched[place] = uvec4(tiles, before, 0u);
    if (gl_LocalInvocationIndex == 0u) counts[gl_WorkGroupID.x] = total;
}
