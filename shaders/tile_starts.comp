#version 430 core
// SPDX-License-Identifier: Apache-2.0
// Where each tile's pairs begin, once they are sorted by tile; one more entry for their end.

layout(local_size_x = THREADS) in;
layout(std430, binding = 0) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 2) writeonly buffer Starts { uint starts[]; };
layout(std430, binding = 4) readonly buffer Pairs { uint needed, pairs, unused_a, unused_b; };

uniform uint tiles;

// Tiles after the one before this pair, up to its own; tiles without pairs are written so too.
void main() {
    uint pair = gl_GlobalInvocationID.x;
    if (pair > pairs) return;
    uint first = pair == 0u ? 0u : keys[pair - 1u] + 1u;
    uint last = pair == pairs ? tiles : keys[pair];
    for (uint tile = first; tile <= last; ++tile) starts[tile] = pair;
}
