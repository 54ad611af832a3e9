// SPDX-License-Identifier: Apache-2.0
// Projection of one Gaussian (EWA splatting, Zwicker et al. 2001, as in 3D Gaussian Splatting).

uniform sampler2D gaussians;    // 3 texels each: mean + opacity, quaternion wxyz, scale
uniform sampler2D harmonics;    // SH_COUNT texels each, rgb
uniform vec4 cam_from_world[3]; // rows
uniform vec3 camera_centre;     // in the world
uniform vec2 focal;
uniform vec2 principal;
uniform vec4 slope_limit;       // clamp of x/z and y/z in the Jacobian: min xy, max xy
uniform bool antialiased;

const float LOW_PASS = 0.3;
const float MIN_ALPHA = 1.0 / 255.0;

vec3 sh(int gaussian, int k) {
    int texel = gaussian * SH_COUNT + k;
    int width = textureSize(harmonics, 0).x;
    return texelFetch(harmonics, ivec2(texel % width, texel / width), 0).rgb;
}

vec3 view_colour(int g, vec3 d) {
    vec3 c = 0.5 + 0.28209479177387814 * sh(g, 0);
#if SH_COUNT > 1
    float x = d.x, y = d.y, z = d.z;
    c += 0.4886025119029199 * (-y * sh(g, 1) + z * sh(g, 2) - x * sh(g, 3));
#endif
#if SH_COUNT > 4
    float xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
    c += 1.0925484305920792 * (xy * sh(g, 4) - yz * sh(g, 5) - xz * sh(g, 7))
       + 0.31539156525252005 * (2.0 * zz - xx - yy) * sh(g, 6)
       + 0.5462742152960396 * (xx - yy) * sh(g, 8);
#endif
#if SH_COUNT > 9
    c += -0.5900435899266435 * (y * (3.0 * xx - yy) * sh(g, 9) + x * (xx - 3.0 * yy) * sh(g, 15))
       + 2.890611442640554 * xy * z * sh(g, 10)
       - 0.4570457994644658 * (4.0 * zz - xx - yy) * (y * sh(g, 11) + x * sh(g, 13))
       + 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * sh(g, 12)
       + 1.445305721320277 * z * (xx - yy) * sh(g, 14);
#endif
    return max(c, 0.0);
}

mat3 rotation(vec4 q) {  // columns: the Gaussian's axes in the world
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
                2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
                2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// Leaves all zero, a quad without area, where the Gaussian is too faint to be seen.
// ellipse: centre (pixels), first half-axis direction * sigma
// extent: second sigma, opacity, z-depth, quad radius in sigmas
void project(int g, out vec4 ellipse, out vec4 extent, out vec4 colour) {
    ellipse = vec4(0.0);
    extent = vec4(0.0);
    colour = vec4(0.0);
    int texel = g * 3;
    int gw = textureSize(gaussians, 0).x;
    vec4 mean_opacity = texelFetch(gaussians, ivec2(texel % gw, texel / gw), 0);
    vec4 quaternion = texelFetch(gaussians, ivec2((texel + 1) % gw, (texel + 1) / gw), 0);
    vec3 scale = texelFetch(gaussians, ivec2((texel + 2) % gw, (texel + 2) / gw), 0).xyz;

    vec4 world = vec4(mean_opacity.xyz, 1.0);
    vec3 p = vec3(dot(cam_from_world[0], world), dot(cam_from_world[1], world),
                  dot(cam_from_world[2], world));
    vec2 centre = focal * p.xy / p.z + principal;

    // M = J R S, 2x3: the image covariance is M M^T + LOW_PASS I. Its determinant comes
    // from the 2x2 minors of M, which keeps thin Gaussians exact in single precision.
    vec2 slope = clamp(p.xy / p.z, slope_limit.xy, slope_limit.zw);
    vec3 j0 = vec3(focal.x / p.z, 0.0, -focal.x * slope.x / p.z);
    vec3 j1 = vec3(0.0, focal.y / p.z, -focal.y * slope.y / p.z);
    mat3 camera_axes = mat3(cam_from_world[0].xyz, cam_from_world[1].xyz, cam_from_world[2].xyz);
    mat3 axes = rotation(quaternion);
    vec3 m0 = ((camera_axes * j0) * axes) * scale;
    vec3 m1 = ((camera_axes * j1) * axes) * scale;
    float a = dot(m0, m0), b = dot(m0, m1), c = dot(m1, m1);
    vec3 minors = cross(m0, m1);
    float det = dot(minors, minors);
    float difference = dot(m0 - m1, m0 + m1);
    float root = sqrt(difference * difference + 4.0 * b * b);
    float first = 0.5 * (a + c + root);
    float second = first > 0.0 ? det / first : 0.0;

    float opacity = mean_opacity.w;
    if (antialiased)
        opacity *= sqrt(first / (first + LOW_PASS)) * sqrt(second / (second + LOW_PASS));
    if (opacity < MIN_ALPHA) return;
    float angle = root > 0.0 ? 0.5 * atan(2.0 * b, difference) : 0.0;
    ellipse = vec4(centre, sqrt(first + LOW_PASS) * vec2(cos(angle), sin(angle)));
    // 1% beyond where alpha falls below 1/255: what is too faint is left out at its pixel anyway.
    extent = vec4(sqrt(second + LOW_PASS), opacity, p.z, 1.01 * sqrt(2.0 * log(255.0 * opacity)));
    colour = vec4(view_colour(g, normalize(mean_opacity.xyz - camera_centre)), 1.0);
}
