# SPDX-License-Identifier: Apache-2.0
"""How well a splat shows photos."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from gscpe.arrays import Float32Array, Float64Array
from gscpe.photos.photo import Photo
from gscpe.render import Renderer
from gscpe.splats.gaussians import GaussianScene


@dataclass(frozen=True)
class Likeness:
    """Means over photos, dB.

    Attributes:
        psnr: of photo and render.
        fitted_psnr: with a gain and a bias fitted for each photo and channel.
    """

    psnr: float
    fitted_psnr: float


def likeness(
    scene: GaussianScene, photos: Sequence[Photo], cam_from_world: Float64Array
) -> Likeness:
    """Compares a splat with photos, rendered over black by the CPU rasterizer.

    Args:
        scene: the splat.
        photos: at least one, pinhole.
        cam_from_world: (P, 4, 4), where they were taken.
    """
    raw, fitted = [], []
    with Renderer(scene, "cpu") as renderer:
        for photo, pose in zip(photos, cam_from_world, strict=True):
            render = np.clip(renderer.render(photo.camera, pose).rgb, 0.0, 1.0)
            truth = photo.rgb.astype(np.float32) / np.float32(255.0)
            valid = np.s_[:, :] if photo.valid is None else photo.valid
            x, y = render[valid].reshape(-1, 3), truth[valid].reshape(-1, 3)
            raw.append(_psnr(x, y))
            fitted.append(_psnr(_exposed_like(x, y), y))
    return Likeness(float(np.mean(raw)), float(np.mean(fitted)))


def _exposed_like(x: Float32Array, y: Float32Array) -> Float32Array:
    """``gain * x + bias`` closest to y, by least squares, channel by channel."""
    mean_x, mean_y = x.mean(axis=0), y.mean(axis=0)
    covariance = ((x - mean_x) * (y - mean_y)).mean(axis=0)
    gain = covariance / np.maximum(((x - mean_x) ** 2).mean(axis=0), 1e-9)
    return np.asarray(np.clip(gain * (x - mean_x) + mean_y, 0.0, 1.0), dtype=np.float32)


def _psnr(x: Float32Array, y: Float32Array) -> float:
    return -10.0 * float(np.log10(max(float(np.mean((x - y) ** 2)), 1e-10)))
