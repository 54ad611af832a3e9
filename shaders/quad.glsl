// One corner of the quad around the ellipse where alpha is at least 1/255.
// Pixel coordinates map straight to the target: row 0 of the image is row 0 of the
// texture, and gl_FragCoord has its centres at (0.5, 0.5) as our cameras do.

uniform vec2 image_size;

out vec2 position;         // in sigmas along the ellipse's axes
flat out vec4 colour_opacity;
flat out float depth;

void put_corner(vec4 ellipse, vec4 extent, vec3 rgb) {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    vec2 first = ellipse.zw;
    float length_first = length(first);
    vec2 second = length_first > 0.0 ? vec2(-first.y, first.x) / length_first * extent.x
                                     : vec2(0.0);
    position = corner * extent.w;
    vec2 pixel = ellipse.xy + position.x * first + position.y * second;
    colour_opacity = vec4(rgb, extent.y);
    depth = extent.z;
    gl_Position = vec4(2.0 * pixel / image_size - 1.0, 0.0, 1.0);
}
