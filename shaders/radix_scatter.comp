#version 430 core
// SPDX-License-Identifier: Apache-2.0
// One pass of a stable radix sort: moves keys and indices to where their digit belongs.
// Each thread owns consecutive keys and a column of counters, local_counts[digit][thread]:
// summed up in this order, they keep keys of equal digits in their order.

layout(local_size_x = THREADS) in;
layout(std430, binding = 0) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 1) readonly buffer Offsets { uint offsets[]; };  // [digit][block]
layout(std430, binding = 5) readonly buffer Indices { uint indices[]; };
layout(std430, binding = 4) readonly buffer Draw {
    uint vertices, visible, first_vertex, base_instance;
};
#ifdef LAST_PASS
layout(r32ui) writeonly uniform uimage2D order;  // farthest first
#else
layout(std430, binding = 2) writeonly buffer KeysOut { uint keys_out[]; };
layout(std430, binding = 3) writeonly buffer IndicesOut { uint indices_out[]; };
#endif

uniform uint shift;

shared uint local_counts[DIGITS * THREADS];
shared uint digit_offsets[DIGITS];

#include "workgroup_scan.glsl"

void main() {
    uint thread = gl_LocalInvocationIndex, block = gl_WorkGroupID.x;
    uint blocks = (visible + uint(BLOCK) - 1u) / uint(BLOCK);
    if (block >= blocks) return;
    for (uint digit = 0u; digit < uint(DIGITS); ++digit)
        local_counts[digit * uint(THREADS) + thread] = 0u;
    uint begin = block * uint(BLOCK) + thread * uint(PER_THREAD);
    uint end = min(begin + uint(PER_THREAD), visible);
    for (uint i = begin; i < end; ++i)
        local_counts[(keys[i] >> shift & uint(DIGITS - 1)) * uint(THREADS) + thread] += 1u;
    wait_for_all();
    uint row = thread * uint(DIGITS), own = 0u, total;
    for (uint k = 0u; k < uint(DIGITS); ++k) own += local_counts[row + k];
    uint sum = sum_before(own, total);
    for (uint k = 0u; k < uint(DIGITS); ++k) {
        uint count = local_counts[row + k];
        local_counts[row + k] = sum;
        sum += count;
    }
    wait_for_all();
    if (thread < uint(DIGITS))
        digit_offsets[thread] = offsets[thread * blocks + block]
                              - local_counts[thread * uint(THREADS)];
    wait_for_all();
    for (uint i = begin; i < end; ++i) {
        uint digit = keys[i] >> shift & uint(DIGITS - 1);
        uint counter = digit * uint(THREADS) + thread;
        uint place = digit_offsets[digit] + local_counts[counter];
        local_counts[counter] += 1u;
#ifdef LAST_PASS
        uint cell = visible - 1u - place;
        uint width = uint(imageSize(order).x);
        imageStore(order, ivec2(cell % width, cell / width), uvec4(indices[i]));
#else
        keys_out[place] = keys[i];
        indices_out[place] = indices[i];
#endif
    }
}
