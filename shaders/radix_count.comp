#version 430 core
// SPDX-License-Identifier: Apache-2.0
// How often each digit occurs in each block of keys: counts[digit][block].

layout(local_size_x = THREADS) in;
layout(std430, binding = 0) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 1) writeonly buffer Counts { uint counts[]; };
layout(std430, binding = 4) readonly buffer Draw {
    uint vertices, visible, first_vertex, base_instance;
};

uniform uint shift;

shared uint occurrences[DIGITS];

void main() {
    uint thread = gl_LocalInvocationIndex, block = gl_WorkGroupID.x;
    uint blocks = (visible + uint(BLOCK) - 1u) / uint(BLOCK);
    if (block >= blocks) return;
    if (thread < uint(DIGITS)) occurrences[thread] = 0u;
    memoryBarrierShared();
    barrier();
    for (uint k = 0u; k < uint(PER_THREAD); ++k) {
        uint i = block * uint(BLOCK) + k * uint(THREADS) + thread;
        if (i < visible) atomicAdd(occurrences[keys[i] >> shift & uint(DIGITS - 1)], 1u);
    }
    memoryBarrierShared();
    barrier();
    if (thread < uint(DIGITS)) counts[thread * blocks + block] = occurrences[thread];
}
