// SPDX-License-Identifier: Apache-2.0
// One corner of the quad around the ellipse where alpha is at least 1/255.
// Pixel coordinates map straight to the target: row 0 of the image is row 0 of the
// texture, and gl_FragCoord has its centres at (0.5, 0.5) as our cameras do.

uniform vec2 image_size;

flat out vec2 centre;       // pixels
flat out vec4 axes;         // of sigmas_from_pixels
flat out vec4 colour_opacity;
flat out float depth;

#include "ellipse.glsl"

const float MARGIN = 1.0 / 64.0;  // pixels; more than a driver moves a corner

void put_corner(vec4 ellipse, vec4 extent, vec3 rgb) {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    float sigma = length(ellipse.zw);
    vec2 first = sigma > 0.0 ? ellipse.zw / sigma : vec2(0.0);
    vec2 reach = corner * (extent.w * vec2(sigma, extent.x) + MARGIN);
    vec2 pixel = ellipse.xy + reach.x * first + reach.y * vec2(-first.y, first.x);
    centre = ellipse.xy;
    axes = sigmas_from_pixels(ellipse, extent);
    colour_opacity = vec4(rgb, extent.y);
    depth = extent.z;
    gl_Position = vec4(2.0 * pixel / image_size - 1.0, 0.0, 1.0);
}
