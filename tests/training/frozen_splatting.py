# SPDX-License-Identifier: Apache-2.0
"""3D Gaussian splatting in float64 NumPy whose discrete decisions can be frozen: order, which
pixels an ellipse reaches, and what is clamped. Frozen, it is smooth, so that central differences
give the derivative that a backward pass must have. It takes nothing from gscpe.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from numpy_compositor import LOW_PASS, MAX_ALPHA, MIN_ALPHA, NEAR, harmonics, rotation_from

from gscpe.geometry import Camera
from gscpe.splats import GaussianScene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameters:
    """What is trained, in float64; quaternions of any length are normalized."""

    means: Array
    log_scales: Array
    quaternions: Array
    logits: Array
    sh: Array
    cam_from_world: Array

    @classmethod
    def of(cls, scene: GaussianScene, cam_from_world: Array) -> Parameters:
        opacities = scene.opacities.astype(np.float64)
        return cls(
            scene.means.astype(np.float64),
            np.log(scene.scales.astype(np.float64)),
            scene.quaternions.astype(np.float64),
            np.log(opacities / (1.0 - opacities)),
            scene.sh.astype(np.float64),
            cam_from_world,
        )

    def nudged(self, name: str, index: tuple[int, ...], step: float) -> Parameters:
        array = getattr(self, name).copy()
        array[index] += step
        return replace(self, **{name: array})


@dataclass(frozen=True)
class Decisions:
    """Front to back: Gaussian, pixels that it reaches, those where alpha is clamped, channels
    that are clamped at black, and whether the slopes are."""

    order: list[int]
    reached: list[NDArray[np.bool_]]
    full: list[NDArray[np.bool_]]
    black: list[NDArray[np.bool_]]
    beside: list[NDArray[np.bool_]]


def splat(
    p: Parameters, camera: Camera, antialiased: bool, decisions: Decisions | None = None
) -> tuple[Array, Array, Array, Decisions]:
    """rgb (H, W, 3), opacity and expected depth (H, W), and the decisions taken, or those given."""
    rotation, translation = p.cam_from_world[:3, :3], p.cam_from_world[:3, 3]
    centre = -np.linalg.solve(rotation, translation)
    in_cam = p.means @ rotation.T + translation
    taken = decisions or Decisions(
        [int(g) for g in np.argsort(in_cam[:, 2], kind="stable") if in_cam[g, 2] > NEAR],
        [], [], [], [],
    )  # fmt: skip
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rgb, transmittance = np.zeros((camera.height, camera.width, 3)), np.ones(u.shape)
    depth = np.zeros(u.shape)
    low = np.array([-camera.cx / camera.fx, -camera.cy / camera.fy])
    high = low + np.array([camera.width / camera.fx, camera.height / camera.fy])
    margin = 0.15 * (high - low)
    for n, g in enumerate(taken.order):
        x, y, z = in_cam[g]
        slopes = np.array([x, y]) / z
        held = np.clip(slopes, low - margin, high + margin)
        if decisions is None:
            taken.beside.append(held != slopes)
        sx, sy = np.where(taken.beside[n], held, slopes)
        jacobian = np.array([[camera.fx, 0, -camera.fx * sx], [0, camera.fy, -camera.fy * sy]]) / z
        axes = rotation_from(p.quaternions[g] / np.linalg.norm(p.quaternions[g]))
        half = jacobian @ rotation @ axes @ np.diag(np.exp(p.log_scales[g]))
        bare = half @ half.T
        covariance = bare + LOW_PASS * np.eye(2)
        opacity = 1.0 / (1.0 + np.exp(-p.logits[g]))
        if antialiased:
            opacity *= np.sqrt(np.linalg.det(bare) / np.linalg.det(covariance))
        (a, b), (_, c) = np.linalg.inv(covariance)
        du, dv = u - (camera.fx * x / z + camera.cx), v - (camera.fy * y / z + camera.cy)
        alpha = opacity * np.exp(-0.5 * (a * du**2 + 2 * b * du * dv + c * dv**2))
        towards = p.means[g] - centre
        basis = harmonics(towards / np.linalg.norm(towards))[: p.sh.shape[1]]
        colour = 0.5 + basis @ p.sh[g]
        if decisions is None:
            taken.reached.append(alpha >= MIN_ALPHA)
            taken.full.append(alpha > MAX_ALPHA)
            taken.black.append(colour < 0)
        alpha = np.where(taken.full[n], MAX_ALPHA, alpha) * taken.reached[n]
        rgb += (transmittance * alpha)[:, :, None] * np.where(taken.black[n], 0.0, colour)
        depth += transmittance * alpha * z
        transmittance = transmittance * (1.0 - alpha)
    opacity = 1.0 - transmittance
    return rgb, opacity, depth / np.maximum(opacity, 1e-12), taken
