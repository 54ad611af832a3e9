#version 430 core
// SPDX-License-Identifier: Apache-2.0
// Composites one tile, front to back; a thread has ROWS pixels of a column (TILE = ROWS * THREAD_ROWS), so that it fetches a
// Gaussian once for all of them, and their arithmetic overlaps. The workgroup fetches Gaussians
// together, BATCH at a time, and ends when none of its pixels lets light through.

layout(local_size_x = TILE, local_size_y = THREAD_ROWS) in;
layout(std430, binding = 0) readonly buffer Splats { vec4 splats[]; };
layout(std430, binding = 1) readonly buffer Starts { uint starts[]; };
layout(std430, binding = 2) writeonly buffer Planes { float planes[]; };
layout(std430, binding = 4) readonly buffer Pairs { uint needed, pairs, unused_a, unused_b; };
layout(std430, binding = 5) readonly buffer Indices { uint indices[]; };

uniform uvec2 image_size;

const uint THREADS = uint(TILE * THREAD_ROWS);
const float OPAQUE = 1e-4;

shared vec4 centres[BATCH];  // and opacity, depth
shared vec4 axes[BATCH];
shared vec4 colours[BATCH];
shared uint light;

void wait_for_all() {
    memoryBarrierShared();
    barrier();
}

void write(uvec2 pixel, vec3 rgb, float opacity, float depth, float variance) {
    uint size = image_size.x * image_size.y, at = pixel.y * image_size.x + pixel.x;
    planes[3u * at] = rgb.r;
    planes[3u * at + 1u] = rgb.g;
    planes[3u * at + 2u] = rgb.b;
    planes[3u * size + at] = opacity;
    planes[4u * size + at] = depth;
    planes[5u * size + at] = variance;
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint tile = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
    uint begin = starts[tile], end = starts[tile + 1u];
    uvec2 top = uvec2(gl_GlobalInvocationID.x, gl_GlobalInvocationID.y * uint(ROWS));
    vec2 pixel = vec2(top) + 0.5;
    float transmittance[ROWS];
    vec3 rgb[ROWS];
    // Moments of the depth beyond the nearest one, which keeps them exact far away.
    vec2 moments[ROWS];
    float nearest = begin < end ? splats[3u * indices[begin]].w : 0.0, most = 0.0;
    for (int r = 0; r < ROWS; ++r) {
        bool inside = top.x < image_size.x && top.y + uint(r) < image_size.y;
        transmittance[r] = inside ? 1.0 : 0.0;
        rgb[r] = vec3(0.0);
        moments[r] = vec2(0.0);
        most = max(most, transmittance[r]);
    }
    for (uint batch = begin; batch < end; batch += uint(BATCH)) {
        if (thread == 0u) light = 0u;
        wait_for_all();
        if (most >= OPAQUE) light = 1u;
        uint count = min(uint(BATCH), end - batch);
        for (uint k = thread; k < count; k += THREADS) {
            uint place = 3u * indices[batch + k];
            centres[k] = splats[place];
            axes[k] = splats[place + 1u];
            colours[k] = splats[place + 2u];
        }
        wait_for_all();
        if (light == 0u) break;
        if (most >= OPAQUE) {
            for (uint k = 0u; k < count; ++k) {
                vec4 here = centres[k], axis = axes[k];
                vec2 away = pixel - here.xy;
                vec2 position = vec2(dot(away, axis.xy), dot(away, axis.zw));
                float alpha[ROWS];
                for (int r = 0; r < ROWS; ++r) {
                    vec2 at = position + float(r) * axis.yw;
                    float faint = here.z * exp(-0.5 * dot(at, at));
                    // Nothing where it is too faint, or not a number.
                    alpha[r] = faint >= 1.0 / 255.0 ? min(faint, 0.99) : 0.0;
                }
                vec3 colour = colours[k].rgb;
                float beyond = here.w - nearest;
                vec2 powers = vec2(beyond, beyond * beyond);
                for (int r = 0; r < ROWS; ++r) {
                    float weight = alpha[r] * transmittance[r];
                    rgb[r] += weight * colour;
                    moments[r] += weight * powers;
                    transmittance[r] -= weight;
                }
            }
            most = 0.0;
            for (int r = 0; r < ROWS; ++r) most = max(most, transmittance[r]);
        }
        wait_for_all();
    }
    if (thread == 0u && tile == 0u)
        planes[6u * image_size.x * image_size.y] = uintBitsToFloat(needed);
    for (int r = 0; r < ROWS; ++r) {
        uvec2 here = top + uvec2(0u, uint(r));
        if (here.x >= image_size.x || here.y >= image_size.y) continue;
        float opacity = 1.0 - transmittance[r];
        vec2 mean = opacity > 0.0 ? moments[r] / opacity : vec2(0.0);
        write(here, rgb[r], opacity, opacity > 0.0 ? nearest + mean.x : 0.0,
              max(mean.y - mean.x * mean.x, 0.0));
    }
}
