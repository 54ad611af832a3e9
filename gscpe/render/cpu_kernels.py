"""Loops of the CPU rasterizer, compiled by Numba. They release the GIL, so that plain
threads run them side by side; nothing here knows about threads.

The form of the loops is what makes them fast. The compositing of a row vectorizes only
with an unsigned index (a signed one may wrap around), a trip count that the compiler does
not see (it would unroll first), all planes in one buffer (else aliasing is possible), and a
sum, not a maximum, as the test for opaque rows.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TILE = 16
"""Width and height of a tile in pixels; a row of a tile is what the compiler vectorizes."""

RECORD = 12
"""Floats kept of a projected Gaussian: see the indices below."""

_U, _V, _A, _B, _C, _OPACITY, _RED, _GREEN, _BLUE, _DEPTH, _CUTOFF, _REACH = range(RECORD)

_F = np.float32
_U64 = np.uint64
_FAST = {"nnan", "ninf", "nsz", "arcp", "contract", "afn", "reassoc"}
_MIN_ALPHA = _F(1.0 / 255.0)
_MAX_ALPHA = _F(0.99)
_LOW_PASS = _F(0.3)
_OPAQUE = _F(1e-4)
_PLANE = TILE * TILE


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
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
        records[i, _RED + k] = max(colour, _F(0.0))


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def project(  # noqa: PLR0915 - one formula after the other; a call each would cost time
    begin, end, candidates, depths, means, quaternions, scales, opacities, sh,
    rotation, translation, centre, intrinsics, limits, stretch, size, antialiased,
    records, tile_rows,
):  # fmt: skip
    """Projects candidates[begin:end] (EWA, as shaders/project.frag) into their records.

    tile_rows gets the number of rows of tiles that each touches, 0 for none.
    """
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    width, height = size[0], size[1]
    for i in range(begin, end):
        tile_rows[i] = 0
        g = candidates[i]
        opacity = opacities[g]
        z = depths[i]
        inverse_z = _F(1.0) / z
        mx, my, mz = means[g, 0], means[g, 1], means[g, 2]
        slope_x = (
            rotation[0, 0] * mx + rotation[0, 1] * my + rotation[0, 2] * mz + translation[0]
        ) * inverse_z
        slope_y = (
            rotation[1, 0] * mx + rotation[1, 1] * my + rotation[1, 2] * mz + translation[1]
        ) * inverse_z
        u, v = fx * slope_x + cx, fy * slope_y + cy

        # A bound by the largest axis first: most Gaussians outside end here.
        cutoff = _F(2.0) * math.log(_F(255.0) * opacity)
        sigmas = math.sqrt(max(cutoff, _F(0.0)))
        s0, s1, s2 = scales[g, 0], scales[g, 1], scales[g, 2]
        reach = sigmas * (max(s0, s1, s2) * inverse_z * stretch + _F(0.55))
        if u + reach < 0 or v + reach < 0 or u - reach > width or v - reach > height:
            continue

        # M = J R S, 2x3: the image covariance is M M^T + LOW_PASS I, and its determinant
        # comes from the 2x2 minors of M, which keeps thin Gaussians exact.
        sx = min(max(slope_x, limits[0]), limits[2])
        sy = min(max(slope_y, limits[1]), limits[3])
        a0, c0 = fx * inverse_z, -fx * sx * inverse_z
        b1, c1 = fy * inverse_z, -fy * sy * inverse_z
        j00 = a0 * rotation[0, 0] + c0 * rotation[2, 0]
        j01 = a0 * rotation[0, 1] + c0 * rotation[2, 1]
        j02 = a0 * rotation[0, 2] + c0 * rotation[2, 2]
        j10 = b1 * rotation[1, 0] + c1 * rotation[2, 0]
        j11 = b1 * rotation[1, 1] + c1 * rotation[2, 1]
        j12 = b1 * rotation[1, 2] + c1 * rotation[2, 2]
        qw, qx, qy, qz = quaternions[g, 0], quaternions[g, 1], quaternions[g, 2], quaternions[g, 3]
        one, two = _F(1.0), _F(2.0)
        r00 = one - two * (qy * qy + qz * qz)
        r01 = two * (qx * qy - qw * qz)
        r02 = two * (qx * qz + qw * qy)
        r10 = two * (qx * qy + qw * qz)
        r11 = one - two * (qx * qx + qz * qz)
        r12 = two * (qy * qz - qw * qx)
        r20 = two * (qx * qz - qw * qy)
        r21 = two * (qy * qz + qw * qx)
        r22 = one - two * (qx * qx + qy * qy)
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
        determinant = sharp + _LOW_PASS * (a + c) + _LOW_PASS * _LOW_PASS
        if antialiased:
            opacity = opacity * math.sqrt(sharp / determinant)
            if opacity < _MIN_ALPHA:
                continue
            cutoff = _F(2.0) * math.log(_F(255.0) * opacity)
            sigmas = math.sqrt(cutoff)
        a += _LOW_PASS
        c += _LOW_PASS
        reach_u, reach_v = sigmas * math.sqrt(a), sigmas * math.sqrt(c)
        first_row = max(v - reach_v, _F(0.0))
        last_row = min(v + reach_v, height)
        if u + reach_u <= 0 or u - reach_u >= width or first_row >= last_row:
            continue

        dx, dy, dz = mx - centre[0], my - centre[1], mz - centre[2]
        inverse_length = _F(1.0) / math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * inverse_length, dy * inverse_length, dz * inverse_length
        _store_colour(records, i, sh, g, dx, dy, dz)
        inverse_determinant = _F(1.0) / determinant
        records[i, _U] = u
        records[i, _V] = v
        records[i, _A] = c * inverse_determinant
        records[i, _B] = -b * inverse_determinant
        records[i, _C] = a * inverse_determinant
        records[i, _OPACITY] = opacity
        records[i, _DEPTH] = z
        records[i, _CUTOFF] = cutoff
        records[i, _REACH] = reach_v
        last_tile_row = (int(height) - 1) // TILE
        tile_rows[i] = min(int(last_row) // TILE, last_tile_row) - int(first_row) // TILE + 1


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def find_spans(chunk, begin, end, order, records, offsets, width, ordered, spans, counts):
    """Puts records of order[begin:end] in that order, and finds the tiles each ellipse
    touches: a first and a last column for each of its rows of tiles; none if last < first.

    counts[chunk] gets the number of ellipses of this chunk that touch each tile.
    """
    columns = (width + TILE - 1) // TILE
    half = _F(0.5)
    for i in range(begin, end):
        source = order[i]
        for k in range(RECORD):
            ordered[i, k] = records[source, k]
        u, v = ordered[i, _U], ordered[i, _V]
        a, b, c = ordered[i, _A], ordered[i, _B], ordered[i, _C]
        cutoff, reach = ordered[i, _CUTOFF], ordered[i, _REACH]
        # a x^2 + 2 b x y + c y^2 = cutoff is widest at x = widest, y = tilt.
        widest = math.sqrt(cutoff * c / (a * c - b * b))
        tilt = -b / c * widest
        inverse_a = _F(1.0) / a
        row = int(max(v - reach, _F(0.0))) // TILE
        for k in range(offsets[i], offsets[i + 1]):
            low = max(_F(row * TILE) + half, v - reach) - v
            high = min(_F(row * TILE + TILE) - half, v + reach) - v
            spans[k, 0] = 1
            spans[k, 1] = 0
            row += 1
            if low > high:  # between two rows of pixel centres
                continue
            y_right = min(max(tilt, low), high)
            y_left = min(max(-tilt, low), high)
            right = b * b * y_right * y_right - a * (c * y_right * y_right - cutoff)
            left = b * b * y_left * y_left - a * (c * y_left * y_left - cutoff)
            right = (-b * y_right + math.sqrt(max(right, _F(0.0)))) * inverse_a + u
            left = (-b * y_left - math.sqrt(max(left, _F(0.0)))) * inverse_a + u
            # A hundredth of a pixel of margin: rounding must not lose a pixel.
            first_pixel = max(math.ceil(left - half - _F(0.01)), 0)
            last_pixel = min(math.floor(right - half + _F(0.01)), width - 1)
            if first_pixel > last_pixel:
                continue
            spans[k, 0] = first_pixel // TILE
            spans[k, 1] = last_pixel // TILE
            for column in range(spans[k, 0], spans[k, 1] + 1):
                counts[chunk, (row - 1) * columns + column] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def fill_entries(chunk, begin, end, ordered, offsets, spans, columns, cursors, entries):
    """Writes ellipses begin to end into the tiles they touch, where the chunk's cursors point."""
    for i in range(begin, end):
        row = int(max(ordered[i, _V] - ordered[i, _REACH], _F(0.0))) // TILE
        for k in range(offsets[i], offsets[i + 1]):
            for column in range(spans[k, 0], spans[k, 1] + 1):
                tile = row * columns + column
                entries[cursors[chunk, tile]] = i
                cursors[chunk, tile] += 1
            row += 1


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _composite_rows(
    planes,
    live,
    tile_width,
    first_row,
    last_row,
    u,
    top,
    a,
    b,
    c,
    opacity,
    limit,
    red,
    green,
    blue,
    z,
):
    """Composites one Gaussian over rows of a tile; returns how many rows became opaque.

    planes holds transmittance, red, green, blue, z, z^2, each a tile, then the pixel
    centres' columns. u and top are the Gaussian's column, and the first row's centre less
    the Gaussian's row.
    """
    became_opaque = 0
    zz = z * z
    for row in range(first_row, last_row + 1):
        if live[row] == 0:
            continue
        dy = top + _F(row)
        by, cyy = b * dy, c * dy * dy
        first = _U64(row) * tile_width
        left = _F(0.0)
        for i in range(tile_width):
            k = first + i
            dx = planes[_U64(6 * _PLANE) + i] - u
            exponent = (a * dx + by) * dx + cyy
            # exp(x) for x in [-6, 0] as (exp(x / 8))^8, with a polynomial: error below 2e-6.
            x = max(exponent, _F(-6.0)) * _F(0.125)
            p = _F(0.00592552) * x + _F(0.03997831)
            p = p * x + _F(0.16615314)
            p = p * x + _F(0.49994501)
            p = p * x + _F(1.0)
            p = p * x + _F(1.0)
            p = p * p
            p = p * p
            p = p * p
            alpha = min(opacity * p, _MAX_ALPHA)
            alpha = alpha if exponent >= limit else _F(0.0)
            transmittance = planes[k]
            weight = alpha * transmittance
            transmittance = transmittance - weight
            planes[k] = transmittance
            planes[k + _U64(_PLANE)] += weight * red
            planes[k + _U64(2 * _PLANE)] += weight * green
            planes[k + _U64(3 * _PLANE)] += weight * blue
            planes[k + _U64(4 * _PLANE)] += weight * z
            planes[k + _U64(5 * _PLANE)] += weight * zz
            left += transmittance
        if left < _OPAQUE:
            live[row] = 0
            became_opaque += 1
    return became_opaque


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def composite_tiles(
    begin, end, tile_width, ordered, starts, entries, columns, rgb, opacity, depth, depth_variance
):
    """Composites the tiles begin to end, front to back, and writes their pixels.

    tile_width is TILE as an unsigned integer; the compiler must not know it.
    """
    height, width = opacity.shape
    planes = np.empty(6 * _PLANE + TILE, _F)
    live = np.empty(TILE, np.uint8)
    for i in range(TILE):
        planes[6 * _PLANE + i] = _F(i) + _F(0.5)
    for tile in range(begin, end):
        left, top = tile % columns * TILE, tile // columns * TILE
        planes[:_PLANE] = _F(1.0)
        planes[_PLANE : 6 * _PLANE] = _F(0.0)
        rows = min(TILE, height - top)
        live[:] = 1
        live_rows = rows
        first_centre = _F(top) + _F(0.5)
        for entry in range(starts[tile], starts[tile + 1]):
            i = entries[entry]
            v, reach, z = ordered[i, _V], ordered[i, _REACH], ordered[i, _DEPTH]
            u = ordered[i, _U] - _F(left)
            a, b, c = _F(-0.5) * ordered[i, _A], -ordered[i, _B], _F(-0.5) * ordered[i, _C]
            limit = _F(-0.5) * ordered[i, _CUTOFF]
            first_row = max(math.ceil(v - reach - first_centre), 0)
            last_row = min(math.floor(v + reach - first_centre), rows - 1)
            live_rows -= _composite_rows(
                planes, live, tile_width, first_row, last_row, u, first_centre - v, a, b, c,
                ordered[i, _OPACITY], limit, ordered[i, _RED], ordered[i, _GREEN],
                ordered[i, _BLUE], z,
            )  # fmt: skip
            if live_rows == 0:
                break
        for row in range(rows):
            for column in range(min(TILE, width - left)):
                k = row * TILE + column
                y, x = top + row, left + column
                alpha = _F(1.0) - planes[k]
                opacity[y, x] = alpha
                rgb[y, x, 0] = planes[_PLANE + k]
                rgb[y, x, 1] = planes[2 * _PLANE + k]
                rgb[y, x, 2] = planes[3 * _PLANE + k]
                mean = planes[4 * _PLANE + k] / alpha if alpha > 0 else _F(0.0)
                square = planes[5 * _PLANE + k] / alpha if alpha > 0 else _F(0.0)
                depth[y, x] = mean
                depth_variance[y, x] = max(square - mean * mean, _F(0.0))
