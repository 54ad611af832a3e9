#version 430 core
// SPDX-License-Identifier: Apache-2.0
// Which Gaussians the image may show: their depth as an integer key, and how many there are
// in each block. The same arithmetic as in visibility_order.py.

layout(local_size_x = THREADS) in;
layout(std430, binding = 0) writeonly buffer Keys { uint keys[]; };
layout(std430, binding = 1) writeonly buffer Counts { uint counts[]; };

uniform uint gaussian_count;
uniform sampler2D gaussians;    // 3 texels each: mean + opacity, quaternion, scale
uniform vec4 cam_from_world[3]; // rows
uniform vec2 focal;
uniform vec2 principal;
uniform vec2 image_size;
uniform float stretch;          // |projection's derivative| <= stretch / z
uniform float near;

const uint CULLED = 0xFFFFFFFFu;
const float LOW_PASS = 0.3;
const float MIN_ALPHA = 1.0 / 255.0;

#include "workgroup_scan.glsl"

vec4 fetch(uint texel) {
    uint width = uint(textureSize(gaussians, 0).x);
    return texelFetch(gaussians, ivec2(texel % width, texel / width), 0);
}

uint depth_key(uint g) {
    vec4 mean_opacity = fetch(3u * g);
    vec3 mean = mean_opacity.xyz;
    vec4 row = cam_from_world[2];
    // Rounded after each step, as NumPy does it, so that the order is the same to the bit.
    precise float zx = mean.x * row.x;
    precise float zy = mean.y * row.y;
    precise float zz = mean.z * row.z;
    precise float zxy = zx + zy;
    precise float zxyz = zxy + zz;
    precise float z = zxyz + row.w;
    if (!(z > near) || mean_opacity.w < MIN_ALPHA) return CULLED;
    vec3 scale = fetch(3u * g + 2u).xyz;
    float sigmas = sqrt(2.0 * log(max(255.0 * mean_opacity.w, 1.0)));
    float reach = sigmas * max(scale.x, max(scale.y, scale.z));
    float radius = reach * stretch / z + sigmas * sqrt(LOW_PASS);
    vec2 xy = vec2(dot(cam_from_world[0].xyz, mean) + cam_from_world[0].w,
                   dot(cam_from_world[1].xyz, mean) + cam_from_world[1].w);
    vec2 pixel = xy / z * focal + principal;
    bool inside = all(greaterThan(pixel + radius, vec2(0.0))) &&
                  all(lessThan(pixel - radius, image_size));
    return inside ? floatBitsToUint(z) : CULLED;
}

void main() {
    uint first = (gl_WorkGroupID.x * uint(THREADS) + gl_LocalInvocationIndex) * uint(PER_THREAD);
    uint visible = 0u;
    for (uint g = first; g < min(first + uint(PER_THREAD), gaussian_count); ++g) {
        uint key = depth_key(g);
        keys[g] = key;
        visible += uint(key != CULLED);
    }
    uint total;
    sum_before(visible, total);
    if (gl_LocalInvocationIndex == 0u) counts[gl_WorkGroupID.x] = total;
}
