#version 430 core
// SPDX-License-Identifier: Apache-2.0
// One workgroup turns counts into the sums of all counts before each.

layout(local_size_x = THREADS) in;
layout(std430, binding = 1) buffer Counts { uint counts[]; };
layout(std430, binding = 4) buffer Draw { uint vertices, visible, first_vertex, base_instance; };

#if defined(AFTER_CULLING) || defined(AFTER_PROJECTION)
#define OF_GAUSSIANS
uniform uint gaussian_count;
#endif
#ifdef AFTER_CULLING
layout(r32ui) writeonly uniform uimage2D visible_count;
#endif
#ifdef AFTER_PROJECTION
uniform uint capacity;
shared uint too_many;
const uint MOST = 0x3FFFFFu;  // of these, a workgroup's sum does not overflow
#endif

#include "workgroup_scan.glsl"

void main() {
#ifdef OF_GAUSSIANS
    uint n = (gaussian_count + uint(BLOCK) - 1u) / uint(BLOCK);
#else
    uint n = (visible + uint(BLOCK) - 1u) / uint(BLOCK) * uint(DIGITS);
#endif
    uint share = (n + uint(THREADS) - 1u) / uint(THREADS);
    uint begin = min(gl_LocalInvocationIndex * share, n), end = min(begin + share, n);
    uint own = 0u;
    for (uint i = begin; i < end; ++i) own += counts[i];
#ifdef AFTER_PROJECTION
    if (gl_LocalInvocationIndex == 0u) too_many = 0u;
    wait_for_all();
    if (own > MOST) too_many = 1u;
    own = min(own, MOST);
#endif
    uint total;
    uint sum = sum_before(own, total);
    for (uint i = begin; i < end; ++i) {
        uint count = counts[i];
        counts[i] = sum;
        sum += count;
    }
#ifdef AFTER_CULLING
    if (gl_LocalInvocationIndex == 0u) {
        visible = total;  // the number of instances to draw
        imageStore(visible_count, ivec2(0), uvec4(total));
    }
#endif
#ifdef AFTER_PROJECTION
    if (gl_LocalInvocationIndex == 0u) {
        vertices = too_many != 0u ? 0xFFFFFFFFu : total;  // how many there are
        visible = min(total, capacity);                   // how many are listed
    }
#endif
}
