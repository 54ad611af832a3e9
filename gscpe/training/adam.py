# SPDX-License-Identifier: Apache-2.0
"""Adam (Kingma, Ba 2015) on the Gaussians that a view shows: a loop compiled by Numba.

Harmonics beyond degree 0 keep no moments of their own. Their learning rate is so small that a
first moment would only delay, by ten views, a sum that takes thousands; and the second moment of
a coefficient is that of its colour times the square of the harmonic. So three quarters of what
Adam would read and write a view is not there.
"""

from __future__ import annotations

import math

import numpy as np

from gscpe.render.compiled import compiled
from gscpe.render.cpu_projection import FAST
from gscpe.training.backward_projection import (
    COLOUR,
    DIRECTION,
    LOG_SCALE,
    LOGIT,
    PIXEL,
    POSITION,
    QUATERNION,
)
from gscpe.training.harmonics import C0, fill_basis
from gscpe.training.parameters import MOMENTS

_F = np.float32
_FIRST, _SECOND = _F(0.9), _F(0.999)
_EPSILON = _F(1e-15)

_COUNTS = np.arange(1, 20_001, dtype=np.float64)
CORRECTIONS = np.stack(
    [1.0 / (1.0 - 0.9**_COUNTS), 1.0 / np.sqrt(1.0 - 0.999**_COUNTS)], axis=1
).astype(np.float32)
"""What an n-th update's first moment, and the root of its second, are multiplied by."""

_LOGIT_BOUND, _LOG_SCALE_BOUND = _F(12.0), _F(30.0)


@compiled(fastmath=FAST)
def update_gaussians(  # noqa: PLR0915 - all that is to be done for a Gaussian, once read
    begin, end, keys, gradients, rates, harmonics_rate, opacity_pull, scale_pull, half_side,
    corrections, means, log_scales, scales, quaternions, logits, opacities, sh, first, second,
    steps, screen_gradients, times_seen,
):  # fmt: skip
    """Updates the Gaussians of the slots begin to end, each of which is another one.

    rates: (MOMENTS,) learning rates. opacity_pull, scale_pull: added to the gradients of opacity
    and scales. screen_gradients and times_seen, (N,), gather the lengths of the gradients with
    respect to the pixel, in half_side pixels, and how often there was one.
    """
    count = sh.shape[1]
    one = _F(1.0)
    gradient, step = np.empty(MOMENTS, np.float32), np.empty(MOMENTS, np.float32)
    basis = np.empty(16, np.float32)
    for slot in range(begin, end):
        g = gradients[slot]
        dx, dy, dz = g[DIRECTION], g[DIRECTION + 1], g[DIRECTION + 2]
        if dx == 0 and dy == 0 and dz == 0:  # hidden
            continue
        i = np.int64(keys[slot] & np.uint64(0xFFFFFFFF))
        for k in range(11):
            gradient[k] = g[k]
        for c in range(3):
            gradient[11 + c] = C0 * g[COLOUR + c]
        opacity = opacities[i]
        gradient[LOGIT] += opacity_pull * opacity * (one - opacity)
        for k in range(3):
            gradient[LOG_SCALE + k] += scale_pull * scales[i, k]
        correct = corrections[min(steps[i], len(corrections) - 1)]
        correct_first, correct_second = correct[0], correct[1]
        steps[i] += 1
        for k in range(MOMENTS):
            m = _FIRST * first[i, k] + (one - _FIRST) * gradient[k]
            v = _SECOND * second[i, k] + (one - _SECOND) * gradient[k] * gradient[k]
            first[i, k] = m
            second[i, k] = v
            step[k] = rates[k] * correct_first * m / (correct_second * math.sqrt(v) + _EPSILON)
        for k in range(3):
            means[i, k] -= step[POSITION + k]
            log_scale = min(log_scales[i, k] - step[LOG_SCALE + k], _LOG_SCALE_BOUND)
            log_scale = max(log_scale, -_LOG_SCALE_BOUND)
            log_scales[i, k] = log_scale
            scales[i, k] = math.exp(log_scale)
        qw = quaternions[i, 0] - step[QUATERNION]
        qx = quaternions[i, 1] - step[QUATERNION + 1]
        qy = quaternions[i, 2] - step[QUATERNION + 2]
        qz = quaternions[i, 3] - step[QUATERNION + 3]
        length = one / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        quaternions[i, 0], quaternions[i, 1] = qw * length, qx * length
        quaternions[i, 2], quaternions[i, 3] = qy * length, qz * length
        logit = min(max(logits[i] - step[LOGIT], -_LOGIT_BOUND), _LOGIT_BOUND)
        logits[i] = logit
        opacities[i] = one / (one + math.exp(-logit))
        for c in range(3):
            sh[i, 0, c] -= step[11 + c]
        if count > 1:
            fill_basis(basis, count, dx, dy, dz)
            scale = harmonics_rate / C0
            red = gradient[11] * scale / (correct_second * math.sqrt(second[i, 11]) + _EPSILON)
            green = gradient[12] * scale / (correct_second * math.sqrt(second[i, 12]) + _EPSILON)
            blue = gradient[13] * scale / (correct_second * math.sqrt(second[i, 13]) + _EPSILON)
            for k in range(1, count):
                sh[i, k, 0] -= basis[k] * red
                sh[i, k, 1] -= basis[k] * green
                sh[i, k, 2] -= basis[k] * blue
        gu, gv = g[PIXEL], g[PIXEL + 1]
        screen_gradients[i] += half_side * math.sqrt(gu * gu + gv * gv)
        times_seen[i] += 1
