// SPDX-License-Identifier: Apache-2.0
// The two vectors whose products with (pixel - centre) are the coordinates in sigmas along the
// ellipse's axes. Taken at each pixel rather than interpolated between corners, which GPUs snap
// to a grid (of 1/256 of a pixel, as a rule: almost 1% of the smallest Gaussian's sigma).
vec4 sigmas_from_pixels(vec4 ellipse, vec4 extent) {
    float sigma = length(ellipse.zw);
    if (!(sigma > 0.0)) return vec4(0.0);
    vec2 first = ellipse.zw / sigma;
    return vec4(first / sigma, vec2(-first.y, first.x) / extent.x);
}
