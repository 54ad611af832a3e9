#version 430 core
// Composites one tile, front to back, one thread a pixel. The workgroup fetches Gaussians
// together, and ends when none of its pixels lets light through.

layout(local_size_x = TILE, local_size_y = TILE) in;
layout(std430, binding = 0) readonly buffer Splats { vec4 splats[]; };
layout(std430, binding = 1) readonly buffer Starts { uint starts[]; };
layout(std430, binding = 2) writeonly buffer Planes { float planes[]; };
layout(std430, binding = 4) readonly buffer Pairs { uint needed, pairs, unused_a, unused_b; };
layout(std430, binding = 5) readonly buffer Indices { uint indices[]; };

uniform uvec2 image_size;

const uint BATCH = uint(TILE * TILE);
const float OPAQUE = 1e-4;

shared vec4 where[BATCH];    // centre, opacity, depth
shared vec4 axes[BATCH];
shared vec4 colours[BATCH];
shared uint light;

void wait_for_all() {
    memoryBarrierShared();
    barrier();
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint tile = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
    uint begin = starts[tile], end = starts[tile + 1u];
    vec2 pixel = vec2(gl_GlobalInvocationID.xy) + 0.5;
    bool inside = all(lessThan(gl_GlobalInvocationID.xy, image_size));
    float transmittance = inside ? 1.0 : 0.0;
    vec3 rgb = vec3(0.0);
    // Moments of the depth beyond the nearest one, which keeps them exact far away.
    float nearest = begin < end ? splats[3u * indices[begin]].w : 0.0, first = 0.0, second = 0.0;
    for (uint batch = begin; batch < end; batch += BATCH) {
        if (thread == 0u) light = 0u;
        wait_for_all();
        if (transmittance >= OPAQUE) light = 1u;
        uint count = min(BATCH, end - batch);
        if (thread < count) {
            uint place = 3u * indices[batch + thread];
            where[thread] = splats[place];
            axes[thread] = splats[place + 1u];
            colours[thread] = splats[place + 2u];
        }
        wait_for_all();
        if (light == 0u) break;
        if (transmittance >= OPAQUE) {
            for (uint k = 0u; k < count; ++k) {
                vec4 here = where[k], axis = axes[k];
                vec2 away = pixel - here.xy;
                vec2 position = vec2(dot(away, axis.xy), dot(away, axis.zw));
                float alpha = here.z * exp(-0.5 * dot(position, position));
                if (!(alpha >= 1.0 / 255.0)) continue;  // too faint, or not a number
                float weight = min(alpha, 0.99) * transmittance, beyond = here.w - nearest;
                rgb += weight * colours[k].rgb;
                first += weight * beyond;
                second += weight * beyond * beyond;
                transmittance -= weight;
            }
        }
        wait_for_all();
    }
    if (thread == 0u && tile == 0u)
        planes[6u * image_size.x * image_size.y] = uintBitsToFloat(needed);
    if (!inside) return;
    uint size = image_size.x * image_size.y;
    uint at = gl_GlobalInvocationID.y * image_size.x + gl_GlobalInvocationID.x;
    float opacity = 1.0 - transmittance;
    float mean = opacity > 0.0 ? first / opacity : 0.0;
    planes[3u * at] = rgb.r;
    planes[3u * at + 1u] = rgb.g;
    planes[3u * at + 2u] = rgb.b;
    planes[3u * size + at] = opacity;
    planes[4u * size + at] = opacity > 0.0 ? nearest + mean : 0.0;
    planes[5u * size + at] = opacity > 0.0 ? max(second / opacity - mean * mean, 0.0) : 0.0;
}
