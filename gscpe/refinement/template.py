# SPDX-License-Identifier: Apache-2.0
"""The template of Lucas-Kanade: pixels of a render, prepared once, and what they leave of a photo.

For a pixel x of the render a with camera-frame point X = depth * K^-1 x, the photo q, and
T = ``photo_from_anchor``:

    residual  r = I_q(project(T X)) - (gain * I_a(x) + bias)
    Jacobian  J = grad I_a(x) . d project / d X . [I | -[X]x],   constant while a stays
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array, IntArray
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.projection import unproject_image
from gscpe.refinement.products import combined, compiled_loops, inner_products
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.sampling import gradient, sample_bilinear
from gscpe.refinement.solver_settings import LucasKanadeSettings


@dataclass(frozen=True, eq=False)
class Template:
    """Pixels of the anchor, prepared once: points, intensities, Jacobians.

    Attributes:
        points: (3, N) float32 in the anchor's camera frame.
        intensities: (N,) float32.
        jacobian: (N, 6) float32, d intensity / d delta.
        motion: (6, 6) M with ``delta^T M delta`` the mean squared pixel motion of a step.
    """

    points: Float32Array
    intensities: Float32Array
    jacobian: Float32Array
    motion: Float64Array

    def thinned(self, count: int) -> Template:
        """About so many of its pixels, evenly."""
        step = max(1, round(len(self.intensities) / count))
        return replace(
            self,
            points=np.ascontiguousarray(self.points[:, ::step]),
            intensities=self.intensities[::step].copy(),
            jacobian=self.jacobian[::step].copy(),
        )


def build_template(anchor: AnchorLevel, settings: LucasKanadeSettings) -> Template | None:
    """The template of an anchor level, or None when too few pixels are usable."""
    chosen = np.flatnonzero(_interior(anchor.valid))
    if len(chosen) < settings.min_pixels:
        return None
    chosen = _thin(chosen, settings.max_template_pixels)
    loops = compiled_loops()
    rows = _template_of if loops is None else loops.template_of
    points, intensities, jacobian = rows(anchor.image, anchor.depth, anchor.camera, chosen)
    return Template(points, intensities, jacobian, _mean_motion(anchor.camera, *points))


def motion_of(template: Template, photo_from_anchor: Float64Array) -> float:
    """How far this moves the template's pixels, root mean square."""
    xi = se3.log(photo_from_anchor)
    return float(np.sqrt(xi @ template.motion @ xi))


def residuals_of(
    template: Template,
    photo: ImageLevel,
    photo_from_anchor: Float64Array,
    gain: float,
    bias: float,
) -> tuple[Float32Array, BoolArray]:
    """Residuals, (N,), zero where the template leaves the photo; and where it does not."""
    loops = compiled_loops()
    if loops is not None:
        found: tuple[Float32Array, BoolArray] = loops.residuals_of(
            *(template.points, template.intensities, photo.image, photo.valid),
            *(photo_from_anchor, photo.camera, gain, bias),
        )
        return found
    u, v, ahead = warp(template.points, photo_from_anchor, photo.camera)
    values, inside = sample_bilinear(photo.image, photo.valid, u, v)
    usable = inside & ahead
    residuals = values - (np.float32(gain) * template.intensities + np.float32(bias))
    return np.where(usable, residuals, np.float32(0.0)), usable


def warp(
    points: Float32Array, photo_from_anchor: Float64Array, camera: Camera
) -> tuple[Float32Array, Float32Array, BoolArray]:
    """Pixels u, v of anchor points, (3, N), in the photo, and whether they lie ahead."""
    rotation = photo_from_anchor[:3, :3].astype(np.float32)
    moved = combined(rotation, points) + photo_from_anchor[:3, 3, None].astype(np.float32)
    ahead = moved[2] > 1e-3
    inverse_z = 1.0 / np.where(ahead, moved[2], np.float32(1.0))
    u = moved[0] * inverse_z * np.float32(camera.fx) + np.float32(camera.cx)
    v = moved[1] * inverse_z * np.float32(camera.fy) + np.float32(camera.cy)
    return u, v, ahead


def _template_of(
    image: Float32Array, depth: Float32Array, camera: Camera, chosen: IntArray
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """As :func:`gscpe.refinement.compiled_loops.template_of`."""
    gradient_u, gradient_v = gradient(image)
    points = unproject_image(camera, depth, chosen)
    x, y, z = points
    by_x = gradient_u.ravel()[chosen] * np.float32(camera.fx) / z
    by_y = gradient_v.ravel()[chosen] * np.float32(camera.fy) / z
    by_z = -(by_x * x + by_y * y) / z
    jacobian = np.stack(
        [by_x, by_y, by_z, by_z * y - by_y * z, by_x * z - by_z * x, by_y * x - by_x * y], axis=1
    )
    return points, image.ravel()[chosen], jacobian.astype(np.float32)


def _thin(indices: IntArray, count: int) -> IntArray:
    """About ``count`` of the pixel indices, evenly spread (a Weyl sequence), always the same."""
    if len(indices) <= count:
        return indices
    end = 2**32 * count // len(indices)
    loops = compiled_loops()
    if loops is not None:
        kept: IntArray = loops.thinned(indices, end)
        return kept
    position = indices.astype(np.uint64) * np.uint64(2654435769) & np.uint64(0xFFFFFFFF)
    return indices[position < np.uint64(end)]


def _interior(valid: BoolArray) -> BoolArray:
    """Pixels whose gradient was made of valid pixels only."""
    eroded = cv2.erode(
        valid.astype(np.uint8),
        np.ones((3, 3), dtype=np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    )
    return np.asarray(eroded > 0)


def _mean_motion(camera: Camera, x: Float32Array, y: Float32Array, z: Float32Array) -> Float64Array:
    """(6, 6) M with ``delta^T M delta`` = mean squared pixel motion of a step."""
    step = max(1, len(z) // 2000)
    x, y, z = x[::step].astype(np.float64), y[::step].astype(np.float64), z[::step].astype(float)
    zero = np.zeros_like(z)
    u_row = np.stack([1 / z, zero, -x / z**2, -x * y / z**2, 1 + (x / z) ** 2, -y / z])
    v_row = np.stack([zero, 1 / z, -y / z**2, -1 - (y / z) ** 2, x * y / z**2, x / z])
    u_row, v_row = camera.fx * u_row, camera.fy * v_row
    rows = np.concatenate([u_row, v_row], axis=1).astype(np.float32)
    return inner_products(rows, rows) / len(z)
