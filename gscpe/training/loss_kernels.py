# SPDX-License-Identifier: Apache-2.0
"""Loops of the loss, compiled by Numba: exposure, L1, SSIM, and the gradients of all three.

Images are flat here: rows of 3 * width floats, and HALF rows of zeros above and below, so that the
SSIM's window never leaves them. It blurs with zeros beyond the borders, which makes the blur its
own transpose. SSIM is Wang et al. 2004: a Gaussian window of 11 pixels, sigma 1.5, unbiased by
nothing.
"""

from __future__ import annotations

import numpy as np

from gscpe.render.compiled import compiled
from gscpe.render.cpu_projection import FAST

HALF = 5
"""The window reaches so many pixels to each side."""

STATISTICS = 9
"""Float64 sums of a row: absolute error, SSIM, squared error; and the gradients with respect to
the logarithms of the gains and to the biases, red, green, blue."""

ABSOLUTE, SIMILARITY, SQUARED, LOG_GAIN, BIAS = 0, 1, 2, 3, 6

_F = np.float32
_U64 = np.uint64
_C1, _C2 = _F(0.01**2), _F(0.03**2)
_EXPONENTS = -0.5 * (np.arange(-HALF, HALF + 1) / 1.5) ** 2
_WINDOW = (np.exp(_EXPONENTS) / np.exp(_EXPONENTS).sum()).astype(np.float32)
_W0, _W1, _W2, _W3, _W4, _W5 = (_F(w) for w in _WINDOW[HALF:])


@compiled(fastmath=FAST)
def expose(begin, end, width, rgb, opacity, background, gains, biases, photo, valid, shown, wanted):
    """Rows begin to end of what is compared: ``gain * (render over background) + bias`` in
    shown, the photo in wanted, both in [0, 1] and flat. Nothing where valid, (H, W) or (0, 0),
    is false."""
    masked = valid.size > 0
    for y in range(begin, end):
        at = (y + HALF) * 3 * width
        for x in range(width):
            through = _F(1.0) - opacity[y, x]
            keep = _F(0.0) if masked and not valid[y, x] else _F(1.0)
            for c in range(3):
                seen = gains[c] * (rgb[y, x, c] + through * background[c]) + biases[c]
                shown[at + 3 * x + c] = keep * seen
                wanted[at + 3 * x + c] = keep * _F(photo[y, x, c]) * _F(1.0 / 255.0)


@compiled(fastmath=FAST, inline=True)
def _blurred(row, k, step):
    """The window's mean of a buffer around k."""
    return (
        _W0 * row[k]
        + _W1 * (row[k - step] + row[k + step])
        + _W2 * (row[k - _U64(2) * step] + row[k + _U64(2) * step])
        + _W3 * (row[k - _U64(3) * step] + row[k + _U64(3) * step])
        + _W4 * (row[k - _U64(4) * step] + row[k + _U64(4) * step])
        + _W5 * (row[k - _U64(5) * step] + row[k + _U64(5) * step])
    )


@compiled(fastmath=FAST)
def _blur_products(rows, n, shown, wanted, at):
    """The vertical blur of x, y, x^2, y^2 and x y into five rows, each after HALF * 3 zeros."""
    length, step, margin = _U64(n + 6 * HALF), _U64(n), _U64(3 * HALF)
    for k in range(_U64(0), _U64(n)):
        p = at + k
        x, y = shown[p], wanted[p]
        sx, sy, sxx, syy, sxy = _W0 * x, _W0 * y, _W0 * x * x, _W0 * y * y, _W0 * x * y
        for w, j in ((_W1, 1), (_W2, 2), (_W3, 3), (_W4, 4), (_W5, 5)):
            d = _U64(j) * step
            a, b, s, t = shown[p - d], shown[p + d], wanted[p - d], wanted[p + d]
            sx += w * (a + b)
            sy += w * (s + t)
            sxx += w * (a * a + b * b)
            syy += w * (s * s + t * t)
            sxy += w * (a * s + b * t)
        rows[margin + k] = sx
        rows[margin + length + k] = sy
        rows[margin + _U64(2) * length + k] = sxx
        rows[margin + _U64(3) * length + k] = syy
        rows[margin + _U64(4) * length + k] = sxy


@compiled(fastmath=FAST)
def _compare(rows, n, slopes, plane, at):
    """SSIM of a row, summed; its slopes with respect to the means of x, x^2 and x y go into three
    planes."""
    length, three, margin = _U64(n + 6 * HALF), _U64(3), _U64(3 * HALF)
    total, one, two = _F(0.0), _F(1.0), _F(2.0)
    for i in range(_U64(0), _U64(n)):
        k = margin + i
        x, y = _blurred(rows, k, three), _blurred(rows, k + length, three)
        xx = _blurred(rows, k + _U64(2) * length, three)
        yy = _blurred(rows, k + _U64(3) * length, three)
        xy = _blurred(rows, k + _U64(4) * length, three)
        a1, a2 = two * x * y + _C1, two * (xy - x * y) + _C2
        inverse_b1 = one / (x * x + y * y + _C1)
        inverse_b2 = one / (xx - x * x + yy - y * y + _C2)
        both = inverse_b1 * inverse_b2
        similarity = a1 * a2 * both
        total += similarity
        slope_xx = -similarity * inverse_b2
        slope_xy = two * a1 * both
        p = at + i
        slopes[p] = (
            two * y * a2 * both - two * x * (similarity * inverse_b1 + slope_xx) - y * slope_xy
        )
        slopes[p + plane] = two * slope_xx
        slopes[p + _U64(2) * plane] = slope_xy
    return total


@compiled()
def compare_rows(begin, end, width, shown, wanted, slopes, statistics):
    """SSIM of the rows begin to end, and its slopes; slopes holds three flat images."""
    n, plane = 3 * width, len(shown)
    rows = np.zeros(5 * (n + 6 * HALF), np.float32)
    for y in range(begin, end):
        at = _U64((y + HALF) * n)
        _blur_products(rows, n, shown, wanted, at)
        statistics[y, SIMILARITY] = _compare(rows, n, slopes, _U64(plane), at)


@compiled(fastmath=FAST)
def _blur_slopes(rows, n, slopes, plane, at):
    """The vertical blur of three planes into three rows, each after HALF * 3 zeros."""
    length, step, margin = _U64(n + 6 * HALF), _U64(n), _U64(3 * HALF)
    for k in range(_U64(0), _U64(n)):
        p = at + k
        rows[margin + k] = _blurred(slopes, p, step)
        rows[margin + length + k] = _blurred(slopes, p + plane, step)
        rows[margin + _U64(2) * length + k] = _blurred(slopes, p + _U64(2) * plane, step)


@compiled(fastmath=FAST)
def _row_gradient(rows, n, shown, wanted, at, l1, ssim, gradient):
    """The gradient of the loss with respect to a row of shown; its absolute and squared error."""
    length, three, margin = _U64(n + 6 * HALF), _U64(3), _U64(3 * HALF)
    absolute, squared, zero = _F(0.0), _F(0.0), _F(0.0)
    for i in range(_U64(0), _U64(n)):
        k = margin + i
        x, y = shown[at + i], wanted[at + i]
        similar = _blurred(rows, k, three) + x * _blurred(rows, k + length, three)
        similar += y * _blurred(rows, k + _U64(2) * length, three)
        off = x - y
        absolute += abs(off)
        squared += off * off
        sign = l1 if off > zero else (-l1 if off < zero else zero)
        gradient[i] = sign - ssim * similar
    return absolute, squared


@compiled()
def gradient_rows(
    begin, end, width, shown, wanted, slopes, l1, ssim, rgb, opacity, background, gains, valid,
    rgb_gradient, opacity_gradient, statistics,
):  # fmt: skip
    """Gradients of the rows begin to end with respect to the render, and to the exposure.

    l1 and ssim are the weights of a pixel's channel in the loss.
    """
    n, plane = 3 * width, len(shown)
    rows, gradient = np.zeros(3 * (n + 6 * HALF), np.float32), np.empty(n, np.float32)
    masked = valid.size > 0
    for y in range(begin, end):
        at = _U64((y + HALF) * n)
        _blur_slopes(rows, n, slopes, _U64(plane), at)
        absolute, squared = _row_gradient(rows, n, shown, wanted, at, l1, ssim, gradient)
        statistics[y, ABSOLUTE], statistics[y, SQUARED] = absolute, squared
        for c in range(3):
            statistics[y, LOG_GAIN + c], statistics[y, BIAS + c] = 0.0, 0.0
        for x in range(width):
            through = _F(1.0) - opacity[y, x]
            keep = _F(0.0) if masked and not valid[y, x] else _F(1.0)
            behind = _F(0.0)
            for c in range(3):
                g = keep * gradient[3 * x + c]
                scaled = g * gains[c]
                rgb_gradient[y, x, c] = scaled
                behind += scaled * background[c]
                seen = rgb[y, x, c] + through * background[c]
                statistics[y, LOG_GAIN + c] += scaled * seen
                statistics[y, BIAS + c] += g
            opacity_gradient[y, x] = -behind
