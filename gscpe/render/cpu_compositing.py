# SPDX-License-Identifier: Apache-2.0
"""Composites projected Gaussians, tile by tile: loops of the CPU rasterizer, compiled by Numba.
They release the GIL; nothing here knows about threads.

The form of the inner loop is what makes it fast. It vectorizes only with an unsigned index (a
signed one may wrap around) and all planes in one buffer (else aliasing is possible), and it
runs over whole rows of a tile without a break: starting it anew for each row costs as much
as the row.
"""

from __future__ import annotations

import math

import numpy as np

from gscpe.render.compiled import compiled
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
)  # fmt: skip

_F = np.float32
_U64 = np.uint64

MAX_ALPHA = _F(0.99)
_OPAQUE = _F(1e-4)
PLANE = TILE * TILE
BLOCK = 32  # records gathered at a time


@compiled()
def fill_entries(first, last, slots, tile_rows, spans, columns, cursors, entries):
    """Writes slots, in their order, into the tiles of rows first to last - 1 that they touch,
    where the tiles' cursors point."""
    for slot in slots:
        top, rows, begin = tile_rows[slot, 0], tile_rows[slot, 1], tile_rows[slot, 2]
        for row in range(max(top, first), min(top + rows, last)):
            span = begin + row - top
            for tile in range(row * columns + spans[span, 0], row * columns + spans[span, 1] + 1):
                entries[cursors[tile]] = slot
                cursors[tile] += 1


@compiled(fastmath=FAST, inline=True)
def ellipse_alpha(dx, dy, a, b, c, opacity, limit):
    """Opacity of an ellipse at an offset from its centre, before it is held to MAX_ALPHA; 0
    beyond the limit. a, b, c and limit describe an eighth of the exponent."""
    # exp(8 x) for x in [-0.75, 0] as exp(x)^8, with a polynomial: error below 2e-6.
    x = (a * dx + b * dy) * dx + c * dy * dy
    p = _F(0.00592552) * x + _F(0.03997831)
    p = p * x + _F(0.16615314)
    p = p * x + _F(0.49994501)
    p = p * x + _F(1.0)
    p = p * x + _F(1.0)
    p = p * p
    p = p * p
    p = p * p
    return opacity * p if x >= limit else _F(0.0)


@compiled(fastmath=FAST)
def _composite_ellipse(
    planes, first, last, u, v, a, b, c, opacity, limit, red, green, blue, z
):  # fmt: skip
    """Composites one Gaussian over the pixels first to last - 1 of a tile, row by row.

    planes holds transmittance, red, green, blue, z, z^2, and the pixel centres' columns and
    rows, each a tile. a, b, c and limit describe an eighth of the exponent.
    """
    zz = z * z
    for k in range(first, last):
        dx = planes[k + _U64(6 * PLANE)] - u
        dy = planes[k + _U64(7 * PLANE)] - v
        peak = ellipse_alpha(dx, dy, a, b, c, opacity, limit)
        alpha = min(peak, MAX_ALPHA)
        transmittance = planes[k]
        weight = alpha * transmittance
        planes[k] = transmittance - weight
        planes[k + _U64(PLANE)] += weight * red
        planes[k + _U64(2 * PLANE)] += weight * green
        planes[k + _U64(3 * PLANE)] += weight * blue
        planes[k + _U64(4 * PLANE)] += weight * z
        planes[k + _U64(5 * PLANE)] += weight * zz


@compiled()
def live_rows(planes, first, last):
    """The first and the last row, of those given, that let light through; last < first if
    none does."""
    while first <= last and planes[first * TILE : (first + 1) * TILE].max() < _OPAQUE:
        first += 1
    while first <= last and planes[last * TILE : (last + 1) * TILE].max() < _OPAQUE:
        last -= 1
    return first, last


@compiled(fastmath=FAST)
def composite_tiles(
    begin, end, records, starts, entries, columns, rgb, opacity, depth, depth_variance
):
    """Composites the tiles begin to end, front to back, and writes their pixels."""
    height, width = opacity.shape
    planes = np.empty(8 * PLANE, _F)
    gathered = np.empty((BLOCK, RECORD), _F)
    for k in range(PLANE):
        planes[6 * PLANE + k] = _F(k % TILE) + _F(0.5)
        planes[7 * PLANE + k] = _F(k // TILE) + _F(0.5)
    for tile in range(begin, end):
        left, top = tile % columns * TILE, tile // columns * TILE
        planes[:PLANE] = _F(1.0)
        planes[PLANE : 6 * PLANE] = _F(0.0)
        rows = min(TILE, height - top)
        first_live, last_live = 0, rows - 1
        for block in range(starts[tile], starts[tile + 1], BLOCK):
            # Gathered first: so the processor waits for many records at once.
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
                _composite_ellipse(
                    planes, _U64(first_row * TILE), _U64(max(last_row + 1, first_row) * TILE), u, v,
                    _F(-0.0625) * record[A], _F(-0.125) * record[B], _F(-0.0625) * record[C],
                    record[OPACITY], _F(-0.0625) * record[CUTOFF],
                    record[RED], record[GREEN], record[BLUE], record[DEPTH],
                )  # fmt: skip
            first_live, last_live = live_rows(planes, first_live, last_live)
            if first_live > last_live:
                break
        for row in range(rows):
            for column in range(min(TILE, width - left)):
                k = row * TILE + column
                y, x = top + row, left + column
                alpha = _F(1.0) - planes[k]
                opacity[y, x] = alpha
                rgb[y, x, 0] = planes[PLANE + k]
                rgb[y, x, 1] = planes[2 * PLANE + k]
                rgb[y, x, 2] = planes[3 * PLANE + k]
                mean = planes[4 * PLANE + k] / alpha if alpha > 0 else _F(0.0)
                square = planes[5 * PLANE + k] / alpha if alpha > 0 else _F(0.0)
                depth[y, x] = mean
                depth_variance[y, x] = max(square - mean * mean, _F(0.0))
