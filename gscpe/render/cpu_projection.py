# SPDX-License-Identifier: Apache-2.0
"""Projects Gaussians and finds the tiles that they touch: loops of the CPU rasterizer, compiled
by Numba. They release the GIL, so that plain threads run them side by side; nothing here
knows about threads.
"""

from __future__ import annotations

import math

import numpy as np

from gscpe.render.compiled import compiled

TILE = 16
"""Width and height of a tile in pixels, a power of two."""

RECORD = 12
"""Floats kept of a projected Gaussian: pixel, inverse covariance (A B; B C), opacity, colour,
z, and how far it reaches: CUTOFF where its quadratic form ends, REACH in rows."""

U, V, A, B, C, OPACITY, RED, GREEN, BLUE, DEPTH, CUTOFF, REACH = range(RECORD)

_F = np.float32
_U64 = np.uint64
FAST = {"nnan", "ninf", "nsz", "arcp", "contract", "afn", "reassoc"}
MIN_ALPHA = _F(1.0 / 255.0)
LOW_PASS = _F(0.3)
_SHIFT = 4  # TILE = 1 << _SHIFT


@compiled(fastmath=FAST)
def _store_colour(records, i, sh, g, dx, dy, dz):
    """Evaluates spherical harmonics in the unit direction from the camera to the Gaussian."""
    coefficients = sh.shape[1]
    two = _F(2.0)
    xx, yy, zz, xy, yz, xz = dx * dx, dy * dy, dz * dz, dx * dy, dy * dz, dx * dz
    for k in range(3):
        colour = _F(0.5) + _F(0.28209479177387814) * sh[g, 0, k]
        if coefficients > 1:
            colour += _F(0.4886025119029199) * (
                dz * sh[g, 2, k] - dy * sh[g, 1, k] - dx * sh[g, 3, k]
            )
        if coefficients > 4:
            colour += (
                _F(1.0925484305920792) * (xy * sh[g, 4, k] - yz * sh[g, 5, k] - xz * sh[g, 7, k])
                + _F(0.31539156525252005) * (two * zz - xx - yy) * sh[g, 6, k]
                + _F(0.5462742152960396) * (xx - yy) * sh[g, 8, k]
            )
        if coefficients > 9:
            three = _F(3.0)
            colour += (
                _F(-0.5900435899266435)
                * (dy * (three * xx - yy) * sh[g, 9, k] + dx * (xx - three * yy) * sh[g, 15, k])
                + _F(2.890611442640554) * xy * dz * sh[g, 10, k]
                - _F(0.4570457994644658)
                * (_F(4.0) * zz - xx - yy)
                * (dy * sh[g, 11, k] + dx * sh[g, 13, k])
                + _F(0.3731763325901154) * dz * (two * zz - three * xx - three * yy) * sh[g, 12, k]
                + _F(1.445305721320277) * dz * (xx - yy) * sh[g, 14, k]
            )
        records[i, RED + k] = max(colour, _F(0.0))


@compiled()
def _view_depth(mean, row):
    """As visibility_order.view_depths: without fast mathematics, so that the bits agree."""
    return ((mean[0] * row[0] + mean[1] * row[1]) + mean[2] * row[2]) + row[3]


@compiled(fastmath=FAST)
def _first_pixel(edge, size):
    """The first pixel whose centre lies beyond an edge, ``size`` if none. Rounding must not
    lose one, so the edge gets a hundredth of a pixel of margin."""
    return np.int32(min(max(edge + _F(0.49), _F(0.0)), size))


@compiled(fastmath=FAST)
def _last_pixel(edge, size):
    """The last pixel whose centre lies before an edge, -1 if none."""
    return np.int32(min(max(edge + _F(0.51), _F(0.0)), size)) - np.int32(1)


@compiled(fastmath=FAST)
def _find_spans(spans, used, first_row, rows, width, u, v, reach, a, b, c, cutoff):
    """The tiles that an ellipse touches: a first and a last column for each of its rows of
    tiles, none if last < first."""
    half = _F(0.5)
    # a x^2 + 2 b x y + c y^2 = cutoff is widest at x = widest, y = tilt.
    tilt = -b / c * math.sqrt(cutoff * c / (a * c - b * b))
    inverse_a = _F(1.0) / a
    reduced, scaled = b * b - a * c, a * cutoff
    for k in range(rows):
        top = _F((first_row + k) * TILE) + half
        low = max(top, v - reach) - v
        high = min(top + _F(TILE - 1), v + reach) - v
        spans[used + k, 0] = 1
        spans[used + k, 1] = 0
        if low > high:  # between two rows of pixel centres
            continue
        y_right = min(max(tilt, low), high)
        y_left = min(max(-tilt, low), high)
        right = math.sqrt(max(reduced * y_right * y_right + scaled, _F(0.0))) - b * y_right
        left = -math.sqrt(max(reduced * y_left * y_left + scaled, _F(0.0))) - b * y_left
        # A hundredth of a pixel of margin: rounding must not lose a pixel.
        first_pixel = _first_pixel(left * inverse_a + u, width)
        last_pixel = _last_pixel(right * inverse_a + u, width)
        if first_pixel <= last_pixel:
            spans[used + k, 0] = first_pixel >> _SHIFT
            spans[used + k, 1] = last_pixel >> _SHIFT


@compiled(fastmath=FAST, inline=True)
def image_slope(view, fx, fy, sx, sy, inverse_z):
    """J, 2x3 by rows: how the pixel moves with the point in the world."""
    a0, c0 = fx * inverse_z, -fx * sx * inverse_z
    b1, c1 = fy * inverse_z, -fy * sy * inverse_z
    return (
        a0 * view[0, 0] + c0 * view[2, 0],
        a0 * view[0, 1] + c0 * view[2, 1],
        a0 * view[0, 2] + c0 * view[2, 2],
        b1 * view[1, 0] + c1 * view[2, 0],
        b1 * view[1, 1] + c1 * view[2, 1],
        b1 * view[1, 2] + c1 * view[2, 2],
    )


@compiled(fastmath=FAST, inline=True)
def rotation_of(qw, qx, qy, qz):
    """The rotation of a unit quaternion, 3x3 by rows."""
    one, two = _F(1.0), _F(2.0)
    return (
        one - two * (qy * qy + qz * qz),
        two * (qx * qy - qw * qz),
        two * (qx * qz + qw * qy),
        two * (qx * qy + qw * qz),
        one - two * (qx * qx + qz * qz),
        two * (qy * qz - qw * qx),
        two * (qx * qz - qw * qy),
        two * (qy * qz + qw * qx),
        one - two * (qx * qx + qy * qy),
    )


@compiled(fastmath=FAST)
def project(  # noqa: PLR0915 - one formula after the other; a call each would cost time
    begin, end, task, positions, means, quaternions, scales, opacities, sh, order,
    view, centre, intrinsics, limits, stretch, size, near, antialiased,
    records, record_bits, tile_rows, keys, slot_of, counts,
):  # fmt: skip
    """Projects positions[begin:end] (EWA, as shaders/project.frag) into records, from slot
    ``begin`` on, those that touch no pixel left out.

    For each record: tile_rows gets its first row of tiles, their number, and where its spans
    begin; keys what it is sorted by. slot_of maps a Gaussian to its record, counts[task] gets
    the number of ellipses in each tile. Returns the end of the slots, and the spans.
    """
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    width, height = size[0], size[1]
    columns = (int(width) + TILE - 1) // TILE
    spans = np.empty((2 * (end - begin) + 64, 2), dtype=np.int16)
    used = 0
    zero, one, two = _F(0.0), _F(1.0), _F(2.0)
    slot = begin
    for i in positions[begin:end]:
        z = _view_depth(means[i], view[2])
        if z <= near:
            continue
        opacity = opacities[i]
        inverse_z = one / z
        mx, my, mz = means[i, 0], means[i, 1], means[i, 2]
        slope_x = (view[0, 0] * mx + view[0, 1] * my + view[0, 2] * mz + view[0, 3]) * inverse_z
        slope_y = (view[1, 0] * mx + view[1, 1] * my + view[1, 2] * mz + view[1, 3]) * inverse_z
        u, v = fx * slope_x + cx, fy * slope_y + cy

        # A bound by the largest axis first: most Gaussians outside end here.
        cutoff = two * math.log(_F(255.0) * opacity)
        sigmas = math.sqrt(max(cutoff, zero))
        s0, s1, s2 = scales[i, 0], scales[i, 1], scales[i, 2]
        reach = sigmas * (max(s0, s1, s2) * inverse_z * stretch + _F(0.55))
        if u + reach < 0 or v + reach < 0 or u - reach > width or v - reach > height:
            continue

        # M = J R S, 2x3: the image covariance is M M^T + LOW_PASS I, and its determinant
        # comes from the 2x2 minors of M, which keeps thin Gaussians exact.
        sx = min(max(slope_x, limits[0]), limits[2])
        sy = min(max(slope_y, limits[1]), limits[3])
        j00, j01, j02, j10, j11, j12 = image_slope(view, fx, fy, sx, sy, inverse_z)
        qw, qx, qy, qz = quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3]
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation_of(qw, qx, qy, qz)
        m00 = (j00 * r00 + j01 * r10 + j02 * r20) * s0
        m01 = (j00 * r01 + j01 * r11 + j02 * r21) * s1
        m02 = (j00 * r02 + j01 * r12 + j02 * r22) * s2
        m10 = (j10 * r00 + j11 * r10 + j12 * r20) * s0
        m11 = (j10 * r01 + j11 * r11 + j12 * r21) * s1
        m12 = (j10 * r02 + j11 * r12 + j12 * r22) * s2
        a = m00 * m00 + m01 * m01 + m02 * m02
        b = m00 * m10 + m01 * m11 + m02 * m12
        c = m10 * m10 + m11 * m11 + m12 * m12
        minor0, minor1, minor2 = m01 * m12 - m02 * m11, m02 * m10 - m00 * m12, m00 * m11 - m01 * m10
        sharp = minor0 * minor0 + minor1 * minor1 + minor2 * minor2
        determinant = sharp + LOW_PASS * (a + c) + LOW_PASS * LOW_PASS
        if antialiased:
            opacity = opacity * math.sqrt(sharp / determinant)
            if opacity < MIN_ALPHA:
                continue
            cutoff = _F(2.0) * math.log(_F(255.0) * opacity)
            sigmas = math.sqrt(cutoff)
        a += LOW_PASS
        c += LOW_PASS
        reach_u, reach_v = sigmas * math.sqrt(a), sigmas * math.sqrt(c)
        left, right = _first_pixel(u - reach_u, width), _last_pixel(u + reach_u, width)
        top, bottom = _first_pixel(v - reach_v, height), _last_pixel(v + reach_v, height)
        if left > right or top > bottom:
            continue
        inverse_determinant = one / determinant
        conic_a, conic_b = c * inverse_determinant, -b * inverse_determinant
        conic_c = a * inverse_determinant

        first_row, first_column, last_column = top >> _SHIFT, left >> _SHIFT, right >> _SHIFT
        rows = (bottom >> _SHIFT) - first_row + 1
        if used + rows > len(spans):
            longer = np.empty((2 * len(spans) + rows, 2), dtype=np.int16)
            longer[:used] = spans[:used]
            spans = longer
        if rows == 1 or first_column == last_column:
            for k in range(rows):
                spans[used + k, 0] = first_column
                spans[used + k, 1] = last_column
        else:
            _find_spans(
                spans, used, first_row, rows, width, u, v, reach_v,
                conic_a, conic_b, conic_c, cutoff,
            )  # fmt: skip
        for k in range(rows):
            tiles = (first_row + k) * columns
            for column in range(spans[used + k, 0], spans[used + k, 1] + 1):
                counts[task, tiles + column] += 1

        dx, dy, dz = mx - centre[0], my - centre[1], mz - centre[2]
        inverse_length = one / math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * inverse_length, dy * inverse_length, dz * inverse_length
        _store_colour(records, slot, sh, i, dx, dy, dz)
        records[slot, U] = u
        records[slot, V] = v
        records[slot, A] = conic_a
        records[slot, B] = conic_b
        records[slot, C] = conic_c
        records[slot, OPACITY] = opacity
        records[slot, DEPTH] = z
        records[slot, CUTOFF] = cutoff
        records[slot, REACH] = reach_v
        tile_rows[slot, 0] = first_row
        tile_rows[slot, 1] = rows
        tile_rows[slot, 2] = used
        # The bits of positive floats are ordered as they are; equal ones by their index.
        keys[slot] = (_U64(record_bits[slot, DEPTH]) << _U64(32)) | _U64(order[i])
        slot_of[order[i]] = slot
        used += rows
        slot += 1
    return slot, spans[:used]
