# SPDX-License-Identifier: Apache-2.0
"""Gradients of composited pixels with respect to projected Gaussians: loops compiled by Numba.

Tiles are gone through front to back, as the rasterizer composites them, and not back to front
as in 3DGS. With the gradient g of a pixel's colour C, the weight w and colour c of a Gaussian:

    dL/d(alpha) = T (g c) - R / (1 - alpha),   R = g C - sum of w (g c) up to this Gaussian,

so nothing is kept from the forward pass but its image, transmittance comes from the same sums
as there, and rows end where they end there. What the form of the inner loop owes to the
compiler is told in gscpe.render.cpu_compositing.

The depth D = sum of w z / sum of w has a gradient G at a few pixels only. There the same is done
once more, with w (z - D) G / (sum of w) in the place of w (g c): gradients add up.
"""

from __future__ import annotations

import math

import numpy as np

from gscpe.render.compiled import compiled
from gscpe.render.cpu_compositing import BLOCK, MAX_ALPHA, PLANE, ellipse_alpha, live_rows
from gscpe.render.cpu_projection import (
    BLUE,
    CUTOFF,
    DEPTH,
    FAST,
    GREEN,
    OPACITY,
    REACH,
    RECORD,
    RED,
    TILE,
    A,
    B,
    C,
    U,
    V,
)

SUMS = 9
"""Sums over the pixels of an ellipse, of h = dL/d(exponent), its moments about the centre, and
of the compositing weight times the gradient of each channel. The exponent is
-(A dx^2 + 2 B dx dy + C dy^2) / 2."""

H, H_X, H_Y, H_XX, H_XY, H_YY, W_RED, W_GREEN, W_BLUE = range(SUMS)

TOTALS = SUMS + 1
W_DEPTH = SUMS
"""The totals of a Gaussian over all tiles: the same, and of the weight times dL/dz."""

_F = np.float32
_U64 = np.uint64


@compiled(fastmath=FAST)
def _add_ellipse(
    planes, first, last, u, v, a, b, c, opacity, limit, red, green, blue, sums, entry
):  # fmt: skip
    """The sums of one Gaussian over the pixels first to last - 1 of a tile, row by row.

    planes holds transmittance, R, the gradients of red, green, blue and opacity, and the pixel
    centres' columns and rows, each a tile. a, b, c and limit describe an eighth of the exponent.
    """
    zero, one = _F(0.0), _F(1.0)
    h_sum, h_x, h_y, h_xx, h_xy, h_yy = zero, zero, zero, zero, zero, zero
    w_red, w_green, w_blue = zero, zero, zero
    for k in range(first, last):
        dx = planes[k + _U64(6 * PLANE)] - u
        dy = planes[k + _U64(7 * PLANE)] - v
        peak = ellipse_alpha(dx, dy, a, b, c, opacity, limit)
        alpha = min(peak, MAX_ALPHA)
        transmittance = planes[k]
        weight = alpha * transmittance
        planes[k] = transmittance - weight
        g_red, g_green = planes[k + _U64(2 * PLANE)], planes[k + _U64(3 * PLANE)]
        g_blue, g_opacity = planes[k + _U64(4 * PLANE)], planes[k + _U64(5 * PLANE)]
        part = weight * (red * g_red + green * g_green + blue * g_blue + g_opacity)
        rest = planes[k + _U64(PLANE)] - part
        planes[k + _U64(PLANE)] = rest
        h = part - rest * alpha / (one - alpha)
        h = h if peak <= MAX_ALPHA else zero
        h_sum += h
        h_dx, h_dy = h * dx, h * dy
        h_x += h_dx
        h_y += h_dy
        h_xx += h_dx * dx
        h_xy += h_dx * dy
        h_yy += h_dy * dy
        w_red += weight * g_red
        w_green += weight * g_green
        w_blue += weight * g_blue
    sums[entry, H] = h_sum
    sums[entry, H_X] = h_x
    sums[entry, H_Y] = h_y
    sums[entry, H_XX] = h_xx
    sums[entry, H_XY] = h_xy
    sums[entry, H_YY] = h_yy
    sums[entry, W_RED] = w_red
    sums[entry, W_GREEN] = w_green
    sums[entry, W_BLUE] = w_blue


@compiled(fastmath=FAST)
def _add_depths(
    planes, begin, end, pixels, slopes, depths, through, rests, first, last, u, v, a, b, c,
    opacity, limit, z, sums, depth_sums, entry,
):  # fmt: skip
    """Adds what those pixels of a tile that have a gradient of the depth say about one Gaussian.

    From begin to end - 1, pixels, slopes and depths hold where in the tile, dL/dD / (sum of w), and
    D; through and rests transmittance and R. The others are those of _add_ellipse, which comes
    before.
    """
    for n in range(begin, end):
        k = pixels[n]
        if k < first or k >= last:
            continue
        dx, dy = planes[6 * PLANE + k] - u, planes[7 * PLANE + k] - v
        if (a * dx + b * dy) * dx + c * dy * dy < limit:  # most of them: before the exponential
            continue
        peak = ellipse_alpha(dx, dy, a, b, c, opacity, limit)
        alpha = min(peak, MAX_ALPHA)
        weight = alpha * through[n]
        through[n] -= weight
        depth_sums[entry] += weight * slopes[n]
        part = weight * slopes[n] * (z - depths[n])
        rests[n] -= part
        if peak <= MAX_ALPHA:
            h = part - rests[n] * alpha / (_F(1.0) - alpha)
            sums[entry, H] += h
            sums[entry, H_X] += h * dx
            sums[entry, H_Y] += h * dy
            sums[entry, H_XX] += h * dx * dx
            sums[entry, H_XY] += h * dx * dy
            sums[entry, H_YY] += h * dy * dy


@compiled(fastmath=FAST)
def _load_tile(planes, left, top, rgb, opacity, rgb_gradient, opacity_gradient):
    """Fills planes for a tile; pixels beyond the image have no gradient."""
    height, width = opacity.shape
    planes[:PLANE] = _F(1.0)
    planes[PLANE : 6 * PLANE] = _F(0.0)
    for row in range(min(TILE, height - top)):
        for column in range(min(TILE, width - left)):
            k, y, x = row * TILE + column, top + row, left + column
            total = opacity_gradient[y, x] * opacity[y, x]
            for channel in range(3):
                gradient = rgb_gradient[y, x, channel]
                planes[(2 + channel) * PLANE + k] = gradient
                total += gradient * rgb[y, x, channel]
            planes[PLANE + k] = total
            planes[5 * PLANE + k] = opacity_gradient[y, x]


@compiled()
def sum_tiles(
    begin, end, records, starts, entries, columns, rgb, opacity, rgb_gradient, opacity_gradient,
    depth_starts, depth_pixels, depth_slopes, depths, sums, depth_sums, ends,
):  # fmt: skip
    """The sums of each entry of the tiles begin to end. ends[tile] gets the end of those entries
    that were composited; those behind them get none.

    depth_pixels[depth_starts[tile] : depth_starts[tile + 1]] are the tile's pixels with a gradient
    of the depth, see _add_depths; depth_sums gets sums only for tiles that have some.
    """
    height = opacity.shape[0]
    planes = np.empty(8 * PLANE, np.float32)
    gathered = np.empty((BLOCK, RECORD), np.float32)
    for k in range(PLANE):
        planes[6 * PLANE + k] = _F(k % TILE) + _F(0.5)
        planes[7 * PLANE + k] = _F(k // TILE) + _F(0.5)
    through, rests = (
        np.empty(len(depth_pixels), np.float32),
        np.empty(len(depth_pixels), np.float32),
    )
    for tile in range(begin, end):
        left, top = tile % columns * TILE, tile // columns * TILE
        deep, deep_end = depth_starts[tile], depth_starts[tile + 1]
        through[deep:deep_end] = _F(1.0)
        rests[deep:deep_end] = _F(0.0)
        _load_tile(planes, left, top, rgb, opacity, rgb_gradient, opacity_gradient)
        first_live, last_live = 0, min(TILE, height - top) - 1
        ends[tile] = starts[tile + 1]
        for block in range(starts[tile], starts[tile + 1], BLOCK):
            count = min(BLOCK, starts[tile + 1] - block)
            for n in range(count):
                slot = entries[block + n]
                for k in range(RECORD):
                    gathered[n, k] = records[slot, k]
            for n in range(count):
                record = gathered[n]
                u, v, reach = record[U] - _F(left), record[V] - _F(top), record[REACH]
                first_row = max(math.ceil(v - reach - _F(0.5)), first_live)
                last_row = min(math.floor(v + reach - _F(0.5)), last_live)
                first, last = first_row * TILE, max(last_row + 1, first_row) * TILE
                a, b = _F(-0.0625) * record[A], _F(-0.125) * record[B]
                c, limit = _F(-0.0625) * record[C], _F(-0.0625) * record[CUTOFF]
                _add_ellipse(
                    planes, _U64(first), _U64(last), u, v, a, b, c, record[OPACITY], limit,
                    record[RED], record[GREEN], record[BLUE], sums, block + n,
                )  # fmt: skip
                if deep < deep_end:
                    depth_sums[block + n] = _F(0.0)
                    _add_depths(
                        planes, deep, deep_end, depth_pixels, depth_slopes, depths, through, rests,
                        first, last, u, v, a, b, c, record[OPACITY], limit, record[DEPTH],
                        sums, depth_sums, block + n,
                    )  # fmt: skip
            first_live, last_live = live_rows(planes, first_live, last_live)
            if first_live > last_live:
                ends[tile] = block + count
                break


@compiled()
def add_up_entries(
    first, last, starts, ends, entries, depth_starts, sums, depth_sums, totals
):  # fmt: skip
    """Adds the sums of the entries of slots first to last - 1 to their totals, tile after tile:
    an order that no number of threads changes."""
    for tile in range(len(ends)):
        deep = depth_starts[tile] < depth_starts[tile + 1]
        for entry in range(starts[tile], ends[tile]):
            slot = entries[entry]
            if first <= slot < last:
                for k in range(SUMS):
                    totals[slot, k] += sums[entry, k]
                if deep:
                    totals[slot, W_DEPTH] += depth_sums[entry]
