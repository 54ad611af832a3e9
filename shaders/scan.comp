#version 430 core
// One workgroup turns counts into the sums of all counts before each.

layout(local_size_x = THREADS) in;
layout(std430, binding = 1) buffer Counts { uint counts[]; };
layout(std430, binding = 4) buffer Draw { uint vertices, visible, first_vertex, base_instance; };

#ifdef AFTER_CULLING
uniform uint gaussian_count;
layout(r32ui) writeonly uniform uimage2D visible_count;
#endif

#include "workgroup_scan.glsl"

void main() {
#ifdef AFTER_CULLING
    uint n = (gaussian_count + uint(BLOCK) - 1u) / uint(BLOCK);
#else
    uint n = (visible + uint(BLOCK) - 1u) / uint(BLOCK) * uint(DIGITS);
#endif
    uint share = (n + uint(THREADS) - 1u) / uint(THREADS);
    uint begin = min(gl_LocalInvocationIndex * share, n), end = min(begin + share, n);
    uint own = 0u;
    for (uint i = begin; i < end; ++i) own += counts[i];
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
}
