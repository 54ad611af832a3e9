#version 430 core
// SPDX-License-Identifier: Apache-2.0
// Moves the visible Gaussians together, in the order of their indices.

layout(local_size_x = THREADS) in;
layout(std430, binding = 0) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 1) readonly buffer Offsets { uint offsets[]; };
layout(std430, binding = 2) writeonly buffer KeysOut { uint keys_out[]; };
layout(std430, binding = 3) writeonly buffer IndicesOut { uint indices_out[]; };

uniform uint gaussian_count;

const uint CULLED = 0xFFFFFFFFu;

#include "workgroup_scan.glsl"

void main() {
    uint first = (gl_WorkGroupID.x * uint(THREADS) + gl_LocalInvocationIndex) * uint(PER_THREAD);
    uint end = min(first + uint(PER_THREAD), gaussian_count);
    uint visible = 0u;
    for (uint g = first; g < end; ++g) visible += uint(keys[g] != CULLED);
    uint total;
    uint place = offsets[gl_WorkGroupID.x] + sum_before(visible, total);
    for (uint g = first; g < end; ++g) {
        uint key = keys[g];
        if (key == CULLED) continue;
        keys_out[place] = key;
        indices_out[place] = g;
        ++place;
    }
}
