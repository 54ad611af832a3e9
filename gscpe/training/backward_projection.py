# SPDX-License-Identifier: Apache-2.0
"""From the gradients of projected Gaussians to those of their parameters and of the pose: a loop
compiled by Numba, the mirror of gscpe.render.cpu_projection.project.
"""

from __future__ import annotations

import math

import numpy as np

from gscpe.render.compiled import compiled
from gscpe.render.cpu_projection import (
    DEPTH,
    FAST,
    LOW_PASS,
    RED,
    A,
    B,
    C,
    image_slope,
    rotation_of,
)
from gscpe.training.backward_compositing import (
    H_X,
    H_XX,
    H_XY,
    H_Y,
    H_YY,
    W_DEPTH,
    W_RED,
    H,
)
from gscpe.training.harmonics import slope_of_sum

GRADIENT = 19
"""Floats of a gradient: with respect to position, logarithms of the scales, quaternion (on the
unit sphere), logit of the opacity, and colour where it is not clamped at 0; the direction in
which the colour was seen, of which that of the harmonics follows; and to the pixel (u, v)."""

POSITION, LOG_SCALE, QUATERNION, LOGIT, COLOUR, DIRECTION, PIXEL = 0, 3, 6, 10, 11, 14, 17

_F = np.float32
_TINY = _F(1e-30)


@compiled(fastmath=FAST)
def parameter_gradients(  # noqa: PLR0915 - one formula after the other, as in project
    begin, end, task, records, keys, totals, means, quaternions, scales, opacities, sh,
    view, centre, intrinsics, limits, antialiased, gradients, pose_gradients,
):  # fmt: skip
    """Fills gradients[begin:end], (M, GRADIENT), from the totals of these slots.

    pose_gradients[task], (6,) float64, gets the sum with respect to xi = (translation,
    rotation), where the pose is exp(xi) @ cam_from_world.
    """
    fx, fy = intrinsics[0], intrinsics[1]
    zero, half, one, two = _F(0.0), _F(0.5), _F(1.0), _F(2.0)
    count = sh.shape[1]
    s = np.empty(16, np.float32)
    pose = np.zeros(6, np.float64)
    for slot in range(begin, end):
        i = np.int64(keys[slot] & np.uint64(0xFFFFFFFF))
        record, total, out = records[slot], totals[slot], gradients[slot]
        if (
            total[H] == 0 and total[H_XX] == 0 and total[W_DEPTH] == 0
            and total[W_RED] == 0 and total[W_RED + 1] == 0
        ):  # fmt: skip
            out[:] = zero  # hidden: nothing of it was composited
            continue

        # Pixel and inverse covariance K = (A B; B C), then the covariance: -K G K.
        ka, kb, kc = record[A], record[B], record[C]
        gu = ka * total[H_X] + kb * total[H_Y]
        gv = kb * total[H_X] + kc * total[H_Y]
        ga, gb, gc = -half * total[H_XX], -half * total[H_XY], -half * total[H_YY]
        t00, t01 = ka * ga + kb * gb, ka * gb + kb * gc
        t10, t11 = kb * ga + kc * gb, kb * gb + kc * gc
        va = -(t00 * ka + t01 * kb)
        vb = -(t00 * kb + t01 * kc)  # of each of the two equal elements
        vc = -(t10 * kb + t11 * kc)

        # The Gaussian's axes in the image, as project has them.
        z = record[DEPTH]
        inverse_z = one / z
        mx, my, mz = means[i, 0], means[i, 1], means[i, 2]
        x = view[0, 0] * mx + view[0, 1] * my + view[0, 2] * mz + view[0, 3]
        y = view[1, 0] * mx + view[1, 1] * my + view[1, 2] * mz + view[1, 3]
        slope_x, slope_y = x * inverse_z, y * inverse_z
        sx = min(max(slope_x, limits[0]), limits[2])
        sy = min(max(slope_y, limits[1]), limits[3])
        j00, j01, j02, j10, j11, j12 = image_slope(view, fx, fy, sx, sy, inverse_z)
        qw, qx, qy, qz = quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3]
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation_of(qw, qx, qy, qz)
        s0, s1, s2 = scales[i, 0], scales[i, 1], scales[i, 2]
        m00 = (j00 * r00 + j01 * r10 + j02 * r20) * s0
        m01 = (j00 * r01 + j01 * r11 + j02 * r21) * s1
        m02 = (j00 * r02 + j01 * r12 + j02 * r22) * s2
        m10 = (j10 * r00 + j11 * r10 + j12 * r20) * s0
        m11 = (j10 * r01 + j11 * r11 + j12 * r21) * s1
        m12 = (j10 * r02 + j11 * r12 + j12 * r22) * s2

        # Opacity; antialiased, it was multiplied by sqrt(det(M M^T) / det(M M^T + LOW_PASS I)).
        opacity = opacities[i]
        out[LOGIT] = total[H] * (one - opacity)
        if antialiased:
            a = m00 * m00 + m01 * m01 + m02 * m02
            b = m00 * m10 + m01 * m11 + m02 * m12
            c = m10 * m10 + m11 * m11 + m12 * m12
            minor0, minor1 = m01 * m12 - m02 * m11, m02 * m10 - m00 * m12
            minor2 = m00 * m11 - m01 * m10
            sharp = minor0 * minor0 + minor1 * minor1 + minor2 * minor2
            inverse_sharp = half * total[H] / max(sharp, _TINY)
            inverse_full = half * total[H] / (sharp + LOW_PASS * (a + c) + LOW_PASS * LOW_PASS)
            va += c * inverse_sharp - (c + LOW_PASS) * inverse_full
            vb += b * (inverse_full - inverse_sharp)
            vc += a * inverse_sharp - (a + LOW_PASS) * inverse_full

        # M, and what it is made of: scales, rotation, slope of the image.
        d00, d10 = two * (va * m00 + vb * m10), two * (vb * m00 + vc * m10)
        d01, d11 = two * (va * m01 + vb * m11), two * (vb * m01 + vc * m11)
        d02, d12 = two * (va * m02 + vb * m12), two * (vb * m02 + vc * m12)
        out[LOG_SCALE] = d00 * m00 + d10 * m10
        out[LOG_SCALE + 1] = d01 * m01 + d11 * m11
        out[LOG_SCALE + 2] = d02 * m02 + d12 * m12
        d00, d10, d01, d11, d02, d12 = d00 * s0, d10 * s0, d01 * s1, d11 * s1, d02 * s2, d12 * s2
        e00, e01, e02 = j00 * d00 + j10 * d10, j00 * d01 + j10 * d11, j00 * d02 + j10 * d12
        e10, e11, e12 = j01 * d00 + j11 * d10, j01 * d01 + j11 * d11, j01 * d02 + j11 * d12
        e20, e21, e22 = j02 * d00 + j12 * d10, j02 * d01 + j12 * d11, j02 * d02 + j12 * d12
        gw = two * (qx * (e21 - e12) + qy * (e02 - e20) + qz * (e10 - e01))
        gx = two * (qy * (e01 + e10) + qz * (e02 + e20) + qw * (e21 - e12) - two * qx * (e11 + e22))
        gy = two * (qx * (e01 + e10) + qz * (e12 + e21) + qw * (e02 - e20) - two * qy * (e00 + e22))
        gz = two * (qx * (e02 + e20) + qy * (e12 + e21) + qw * (e10 - e01) - two * qz * (e00 + e11))
        along = gw * qw + gx * qx + gy * qy + gz * qz
        out[QUATERNION] = gw - along * qw
        out[QUATERNION + 1] = gx - along * qx
        out[QUATERNION + 2] = gy - along * qy
        out[QUATERNION + 3] = gz - along * qz
        f00, f01 = d00 * r00 + d01 * r01 + d02 * r02, d00 * r10 + d01 * r11 + d02 * r12
        f02 = d00 * r20 + d01 * r21 + d02 * r22
        f10, f11 = d10 * r00 + d11 * r01 + d12 * r02, d10 * r10 + d11 * r11 + d12 * r12
        f12 = d10 * r20 + d11 * r21 + d12 * r22

        # The point in the camera: by the pixel, by the slope, J = (a0 0 c0; 0 b1 c1) W, and by z.
        ga0 = f00 * view[0, 0] + f01 * view[0, 1] + f02 * view[0, 2]
        gc0 = f00 * view[2, 0] + f01 * view[2, 1] + f02 * view[2, 2]
        gb1 = f10 * view[1, 0] + f11 * view[1, 1] + f12 * view[1, 2]
        gc1 = f10 * view[2, 0] + f11 * view[2, 1] + f12 * view[2, 2]
        a0, c0 = fx * inverse_z, -fx * sx * inverse_z
        b1, c1 = fy * inverse_z, -fy * sy * inverse_z
        free_x = -gc0 * a0 if sx == slope_x else zero
        free_y = -gc1 * b1 if sy == slope_y else zero
        px = (gu * fx + free_x) * inverse_z
        py = (gv * fy + free_y) * inverse_z
        pz = -slope_x * px - slope_y * py
        pz -= (ga0 * a0 + gc0 * c0 + gb1 * b1 + gc1 * c1) * inverse_z
        pz += total[W_DEPTH]

        # The colour, and through its direction the point again.
        dx, dy, dz = mx - centre[0], my - centre[1], mz - centre[2]
        inverse_length = one / math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * inverse_length, dy * inverse_length, dz * inverse_length
        red = total[W_RED] if record[RED] > 0 else zero
        green = total[W_RED + 1] if record[RED + 1] > 0 else zero
        blue = total[W_RED + 2] if record[RED + 2] > 0 else zero
        out[COLOUR], out[COLOUR + 1], out[COLOUR + 2] = red, green, blue
        out[DIRECTION], out[DIRECTION + 1], out[DIRECTION + 2] = dx, dy, dz
        wx, wy, wz = zero, zero, zero
        if count > 1:
            for k in range(1, count):
                s[k] = sh[i, k, 0] * red + sh[i, k, 1] * green + sh[i, k, 2] * blue
            wx, wy, wz = slope_of_sum(s, count, dx, dy, dz)
            along = wx * dx + wy * dy + wz * dz
            wx = (wx - along * dx) * inverse_length
            wy = (wy - along * dy) * inverse_length
            wz = (wz - along * dz) * inverse_length
        out[POSITION] = view[0, 0] * px + view[1, 0] * py + view[2, 0] * pz + wx
        out[POSITION + 1] = view[0, 1] * px + view[1, 1] * py + view[2, 1] * pz + wy
        out[POSITION + 2] = view[0, 2] * px + view[1, 2] * py + view[2, 2] * pz + wz
        out[PIXEL], out[PIXEL + 1] = gu, gv

        # A moved camera moves all points, seen from it; turned, it also turns J's W.
        pose[0] += px + view[0, 0] * wx + view[0, 1] * wy + view[0, 2] * wz
        pose[1] += py + view[1, 0] * wx + view[1, 1] * wy + view[1, 2] * wz
        pose[2] += pz + view[2, 0] * wx + view[2, 1] * wy + view[2, 2] * wz
        pose[3] += y * pz - z * py
        pose[4] += z * px - x * pz
        pose[5] += x * py - y * px
        for k in range(3):
            f0 = f00 if k == 0 else (f01 if k == 1 else f02)
            f1 = f10 if k == 0 else (f11 if k == 1 else f12)
            w0, w1, w2 = a0 * f0, b1 * f1, c0 * f0 + c1 * f1  # dL/dW, a column
            pose[3] += view[1, k] * w2 - view[2, k] * w1
            pose[4] += view[2, k] * w0 - view[0, k] * w2
            pose[5] += view[0, k] * w1 - view[1, k] * w0
    for k in range(6):
        pose_gradients[task, k] = pose[k]
