#version 430 core
// SPDX-License-Identifier: Apache-2.0
// Writes each pair of a tile and a Gaussian that touches it, Gaussian by Gaussian, nearest first.
// One thread a pair, which looks up whose it is: some Gaussians touch one tile, some all.

layout(local_size_x = THREADS) in;
layout(std430, binding = 0) writeonly buffer Keys { uint keys[]; };        // tiles
layout(std430, binding = 1) readonly buffer Offsets { uint offsets[]; };   // of workgroups' pairs
layout(std430, binding = 2) readonly buffer Touched { uvec4 touched[]; };  // of project.comp
layout(std430, binding = 3) writeonly buffer Indices { uint indices[]; };  // Gaussians' places
layout(std430, binding = 4) readonly buffer Pairs { uint needed, pairs, unused_a, unused_b; };

uniform uint blocks;   // workgroups of project.comp
uniform uint columns;  // tiles

void main() {
    uint pair = gl_GlobalInvocationID.x;
    if (pair >= pairs) return;
    // The last workgroup, then in it the last Gaussian, that begins here or before.
    uint block = 0u, end = blocks;
    while (end - block > 1u) {
        uint middle = (block + end) / 2u;
        if (offsets[middle] <= pair) block = middle; else end = middle;
    }
    uint in_block = pair - offsets[block];
    uint place = block * uint(THREADS);
    end = place + uint(THREADS);
    while (end - place > 1u) {
        uint middle = (place + end) / 2u;
        if (touched[middle].z <= in_block) place = middle; else end = middle;
    }
    uvec4 tiles = touched[place];
    uint number = in_block - tiles.z, wide = tiles.y & 0xFFFFu;
    uint column = (tiles.x & 0xFFFFu) + number % wide, row = (tiles.x >> 16) + number / wide;
    keys[pair] = row * columns + column;
    indices[pair] = place;
}
