# SPDX-License-Identifier: Apache-2.0
"""A reference renderer of 3D Gaussian splats: float64 NumPy, written to be read.

It follows the published method (Kerbl et al. 2023, Mip-Splatting 2024) and takes nothing
from gscpe but the scene's arrays and the camera's numbers. One loop over the Gaussians,
front to back, each evaluated at all pixels: only for small images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gscpe.geometry import Camera
from gscpe.splats import GaussianScene

Array = NDArray[np.float64]

NEAR = 0.2
LOW_PASS = 0.3
MIN_ALPHA = 1.0 / 255.0
MAX_ALPHA = 0.99
MIN_TRANSMITTANCE = 1e-4


@dataclass(frozen=True)
class Composite:
    """rgb (H, W, 3), opacity (H, W), expected depth (H, W), depth variance (H, W)."""

    rgb: Array
    opacity: Array
    depth: Array
    depth_variance: Array


def harmonics(direction: Array) -> Array:
    """The 16 real spherical harmonics with the Condon-Shortley signs of 3DGS, (16,)."""
    x, y, z = direction
    pi = np.pi
    return np.array(
        [
            np.sqrt(1 / (4 * pi)),
            -np.sqrt(3 / (4 * pi)) * y,
            np.sqrt(3 / (4 * pi)) * z,
            -np.sqrt(3 / (4 * pi)) * x,
            np.sqrt(15 / (4 * pi)) * x * y,
            -np.sqrt(15 / (4 * pi)) * y * z,
            np.sqrt(5 / (16 * pi)) * (3 * z**2 - 1),
            -np.sqrt(15 / (4 * pi)) * x * z,
            np.sqrt(15 / (16 * pi)) * (x**2 - y**2),
            -np.sqrt(35 / (32 * pi)) * y * (3 * x**2 - y**2),
            np.sqrt(105 / (4 * pi)) * x * y * z,
            -np.sqrt(21 / (32 * pi)) * y * (5 * z**2 - 1),
            np.sqrt(7 / (16 * pi)) * z * (5 * z**2 - 3),
            -np.sqrt(21 / (32 * pi)) * x * (5 * z**2 - 1),
            np.sqrt(105 / (16 * pi)) * z * (x**2 - y**2),
            -np.sqrt(35 / (32 * pi)) * x * (x**2 - 3 * y**2),
        ]
    )


def colour_from(coefficients: Array, direction: Array) -> Array:
    """The colour, (3,), of coefficients (K, 3) seen along a unit direction."""
    basis = harmonics(direction)[: len(coefficients)]
    return np.maximum(0.5 + basis @ coefficients, 0.0)


def rotation_from(quaternion_wxyz: Array) -> Array:
    """The (3, 3) rotation of a unit quaternion: ``R v = q v q*``."""
    w, x, y, z = quaternion_wxyz
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 * w * k + 2 * k @ k)


def image_covariance(
    camera: Camera, cam_from_world: Array, point_in_cam: Array, world_covariance: Array
) -> Array:
    """The (2, 2) covariance in pixels before the low-pass: ``J W Sigma W^T J^T``.

    x/z and y/z in J are held within 15% of the image size beyond its borders, the 1.3 of
    3DGS for a principal point that may be off the centre.
    """
    x, y, z = point_in_cam
    left, right = -camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx
    top, bottom = -camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy
    slope_x = np.clip(x / z, left - 0.15 * (right - left), right + 0.15 * (right - left))
    slope_y = np.clip(y / z, top - 0.15 * (bottom - top), bottom + 0.15 * (bottom - top))
    jacobian = np.array(
        [
            [camera.fx / z, 0.0, -camera.fx * slope_x / z],
            [0.0, camera.fy / z, -camera.fy * slope_y / z],
        ]
    )
    full = jacobian @ cam_from_world[:3, :3]
    return np.asarray(full @ world_covariance @ full.T)


def composite(
    scene: GaussianScene,
    camera: Camera,
    cam_from_world: Array,
    *,
    only: NDArray[np.integer] | None = None,
    min_transmittance: float = MIN_TRANSMITTANCE,
) -> Composite:
    """Renders the scene, or only the Gaussians with these indices."""
    rotation, translation = cam_from_world[:3, :3], cam_from_world[:3, 3]
    centre = -rotation.T @ translation
    means = scene.means.astype(np.float64)
    in_cam = means @ rotation.T + translation
    chosen = np.arange(len(scene)) if only is None else np.asarray(only, dtype=np.intp)
    chosen = np.sort(chosen)
    front_to_back = chosen[np.argsort(in_cam[chosen, 2], kind="stable")]

    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rgb = np.zeros((camera.height, camera.width, 3))
    weights, depth_sum, depth_squared_sum = np.zeros((3, camera.height, camera.width))
    transmittance = np.ones((camera.height, camera.width))
    stopped = np.zeros((camera.height, camera.width), dtype=bool)

    for g in front_to_back:
        x, y, z = in_cam[g]
        if z <= NEAR:
            continue
        axes = rotation_from(scene.quaternions[g].astype(np.float64))
        scales = scene.scales[g].astype(np.float64)
        world_covariance = axes @ np.diag(scales**2) @ axes.T
        bare = image_covariance(camera, cam_from_world, in_cam[g], world_covariance)
        covariance = bare + LOW_PASS * np.eye(2)
        opacity = float(scene.opacities[g])
        if scene.antialiased:
            ratio = np.linalg.det(bare) / np.linalg.det(covariance)
            opacity *= np.sqrt(max(0.0, ratio))
        du = u - (camera.fx * x / z + camera.cx)
        dv = v - (camera.fy * y / z + camera.cy)
        (a, b), (_, c) = np.linalg.inv(covariance)
        alpha = np.minimum(
            MAX_ALPHA, opacity * np.exp(-0.5 * (a * du**2 + 2 * b * du * dv + c * dv**2))
        )
        alpha[alpha < MIN_ALPHA] = 0.0
        stopped |= transmittance * (1.0 - alpha) < min_transmittance
        alpha[stopped] = 0.0
        weight = transmittance * alpha
        towards = (means[g] - centre) / np.linalg.norm(means[g] - centre)
        colour = colour_from(scene.sh[g].astype(np.float64), towards)
        rgb += weight[:, :, None] * colour
        weights += weight
        depth_sum += weight * z
        depth_squared_sum += weight * z**2
        transmittance *= 1.0 - alpha

    seen = np.where(weights > 0, weights, 1.0)
    depth = depth_sum / seen
    return Composite(rgb, weights, depth, np.maximum(depth_squared_sum / seen - depth**2, 0.0))
