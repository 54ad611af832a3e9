# SPDX-License-Identifier: Apache-2.0
"""What training makes small: L1 + 0.2 (1 - SSIM) between an exposed render and a photo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array, UInt8Array
from gscpe.render.kernel_threads import KernelThreads, in_parts
from gscpe.render.view import RenderedView
from gscpe.training.loss_kernels import (
    ABSOLUTE,
    BIAS,
    HALF,
    LOG_GAIN,
    SIMILARITY,
    SQUARED,
    STATISTICS,
    compare_rows,
    expose,
    gradient_rows,
)

_TASK = 16  # rows


@dataclass(frozen=True, eq=False)
class Loss:
    """The loss of a view and its gradients.

    Attributes:
        value: the loss.
        l1: mean absolute error.
        ssim: mean structural similarity.
        squared: mean squared error; PSNR is -10 log10 of it.
        rgb_gradient: (H, W, 3) float32, with respect to the render over black.
        opacity_gradient: (H, W) float32.
        log_gain_gradient, bias_gradient: (3,) float64.
    """

    value: float
    l1: float
    ssim: float
    squared: float
    rgb_gradient: Float32Array
    opacity_gradient: Float32Array
    log_gain_gradient: Float64Array
    bias_gradient: Float64Array


def photo_loss(
    threads: KernelThreads,
    view: RenderedView,
    photo: UInt8Array,
    valid: BoolArray | None,
    background: Float32Array,
    log_gain: Float64Array,
    bias: Float64Array,
    ssim_weight: float,
) -> Loss:
    """Compares ``exp(log_gain) * (render over background) + bias`` with a photo.

    Args:
        threads: run it.
        view: the render.
        photo: (H, W, 3) uint8, of the view's size.
        valid: (H, W), the pixels that count; None for all.
        background: (3,), shows where the render is not opaque.
        log_gain, bias: (3,), the photo's exposure.
        ssim_weight: of 1 - SSIM.
    """
    height, width = view.opacity.shape
    flat = (height + 2 * HALF) * 3 * width
    images = np.zeros((5, flat), dtype=np.float32)
    shown, wanted, slopes = images[0], images[1], images[2:].reshape(-1)
    gains = np.exp(log_gain).astype(np.float32)
    mask = np.zeros((0, 0), dtype=np.bool_) if valid is None else valid
    statistics = np.zeros((height, STATISTICS))
    rgb_gradient = np.empty((height, width, 3), dtype=np.float32)
    opacity_gradient = np.empty((height, width), dtype=np.float32)
    count = 3 * (height * width if valid is None else max(int(np.count_nonzero(valid)), 1))
    parts = in_parts(height, _TASK)
    background = background.astype(np.float32)
    threads.run(
        expose, parts, width, view.rgb, view.opacity, background, gains,
        bias.astype(np.float32), photo, mask, shown, wanted,
    )  # fmt: skip
    threads.run(compare_rows, parts, width, shown, wanted, slopes, statistics)
    threads.run(
        gradient_rows, parts, width, shown, wanted, slopes, np.float32(1.0 / count),
        np.float32(ssim_weight / count), view.rgb, view.opacity, background, gains, mask,
        rgb_gradient, opacity_gradient, statistics,
    )  # fmt: skip
    sums = statistics.sum(axis=0)
    # Pixels that do not count are alike, nothing and nothing, and so perfectly similar.
    ssim = 1.0 - (3 * height * width - float(sums[SIMILARITY])) / count
    l1 = float(sums[ABSOLUTE]) / count
    return Loss(
        value=l1 + ssim_weight * (1.0 - ssim),
        l1=l1,
        ssim=ssim,
        squared=float(sums[SQUARED]) / count,
        rgb_gradient=rgb_gradient,
        opacity_gradient=opacity_gradient,
        log_gain_gradient=sums[LOG_GAIN : LOG_GAIN + 3],
        bias_gradient=sums[BIAS : BIAS + 3],
    )
