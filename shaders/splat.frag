#version 330 core
// SPDX-License-Identifier: Apache-2.0
// Stage 3: alpha of one Gaussian at one pixel; blending composites back to front.

flat in vec2 centre;
flat in vec4 axes;
flat in vec4 colour_opacity;
flat in float depth;

layout(location = 0) out vec4 colour;   // premultiplied
layout(location = 1) out vec4 moments;  // depth, squared depth; premultiplied; w for blending

void main() {
    vec2 from_centre = gl_FragCoord.xy - centre;
    vec2 position = vec2(dot(from_centre, axes.xy), dot(from_centre, axes.zw));
    float alpha = min(0.99, colour_opacity.a * exp(-0.5 * dot(position, position)));
    if (alpha < 1.0 / 255.0) {
#ifdef BLEND_FAINT
        alpha = 0.0;  // changes nothing either, and is faster than a discard on a CPU
#else
        discard;
#endif
    }
    colour = vec4(colour_opacity.rgb * alpha, alpha);
    moments = vec4(depth * alpha, depth * depth * alpha, 0.0, alpha);
}
