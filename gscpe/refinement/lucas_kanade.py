# SPDX-License-Identifier: Apache-2.0
"""Inverse-compositional Lucas-Kanade over SE(3), gain and bias (design: docs/how-it-works.md).

Baker and Matthews, "Lucas-Kanade 20 years on" (IJCV 2004), with a rendered template that
knows its depth. The anchor a is the render, the photo is q, and ``photo_from_anchor`` is
sought. For a template pixel x with camera-frame point X = depth * K^-1 x:

    residual  r = I_q(project(T X)) - (gain * I_a(x) + bias)
    Jacobian  J = grad I_a(x) . d project / d X . [I | -[X]x],   constant while a stays
    step      min sum w (r - [gain J, I_a, 1] (delta, d_gain, d_bias))^2
    update    T <- T exp(delta)^-1
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array, IntArray, short_repr
from gscpe.errors import SettingsError
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.projection import unproject_image
from gscpe.refinement.products import combined, compiled_loops, inner_products
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.robust import TUKEY_CUTOFF, robust_sigma, tukey_weights
from gscpe.refinement.sampling import gradient, sample_bilinear

_MOST_ALIKE = 0.75
"""Factor from one step to the next beyond which nothing is extrapolated."""


@dataclass(frozen=True)
class LucasKanadeSettings:
    """Settings of the solver at one pyramid level.

    Attributes:
        max_iterations: at most (paper: 20).
        converged_pixels: a level ends when a step moves its pixels by less (RMS, pixels of
            that level).
        min_pixels: fewer usable pixels fail.
        max_template_pixels: the template is thinned to about so many, evenly: a quarter of
            a 640x480 image did as well as all of it, the strongest gradients did worse.
        min_noise: lower bound of the robust scale, luminance in [0, 1].
        gain_and_bias: solve for them; else photo and render are compared as they are.
        robust: Tukey's weights; else all residuals count alike.
        extrapolate: go on at the end by the steps that would still follow. Steps shrink by about
            the same factor each, since the anchor's gradients are not the photo's, so that a
            level may end sooner.
    """

    max_iterations: int = 20
    converged_pixels: float = 0.01
    min_pixels: int = 200
    max_template_pixels: int = 80_000
    min_noise: float = 1.0 / 255.0
    gain_and_bias: bool = True
    robust: bool = True
    extrapolate: bool = False

    def __post_init__(self) -> None:
        if self.max_iterations < 1 or self.min_pixels < 8 or self.max_template_pixels < 8:
            raise SettingsError("Lucas-Kanade needs at least one iteration and eight pixels")


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where the template fits the photo.

    Attributes:
        photo_from_anchor: (4, 4).
        gain, bias: photo = gain * anchor + bias.
        residual: robust standard deviation of the photometric residual, luminance.
        pixels: template pixels that were used in the end.
        motion_pixels: how far the template's pixels have moved from where the anchor was
            rendered, root mean square.
        iterations: steps taken.
        converged: whether the last step was small enough.
    """

    photo_from_anchor: Float64Array
    gain: float
    bias: float
    residual: float
    pixels: int
    motion_pixels: float
    iterations: int
    converged: bool

    def __repr__(self) -> str:
        return short_repr(self)


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


def align(
    template: Template,
    photo: ImageLevel,
    photo_from_anchor: Float64Array,
    gain: float,
    bias: float,
    settings: LucasKanadeSettings,
    iterated: Callable[[Float64Array], None] | None = None,
) -> Alignment | None:
    """Aligns a template to the photo, or None when they hardly overlap.

    Args:
        template: of the anchor at this level.
        photo: the photo at the same level.
        photo_from_anchor: (4, 4) start.
        gain, bias: start.
        settings: see :class:`LucasKanadeSettings`.
        iterated: is told the pose, (4, 4), after each iteration.
    """
    converged, iterations = False, 0
    before: Float64Array | None = None
    while True:
        residuals, usable = residuals_of(template, photo, photo_from_anchor, gain, bias)
        if np.count_nonzero(usable) < settings.min_pixels:
            return None
        sigma = max(robust_sigma(residuals[usable]), settings.min_noise)
        if converged or iterations == settings.max_iterations:
            break
        hessian, right = _normal_equations(template, residuals, usable, gain, sigma, settings)
        step = _solve(hessian, right)
        if step is None:
            return None
        photo_from_anchor = photo_from_anchor @ se3.exp(-step[:6])
        if settings.gain_and_bias:
            gain, bias = gain + step[6], bias + step[7]
        iterations += 1
        if iterated is not None:
            iterated(photo_from_anchor)
        moved = np.sqrt(step[:6] @ template.motion @ step[:6])
        converged = bool(moved < settings.converged_pixels)
        if settings.extrapolate:
            if converged and before is not None:
                rest = _rest_of_steps(before, step, template.motion)
                photo_from_anchor = photo_from_anchor @ se3.exp(-rest * step[:6])
            before = step
    return Alignment(
        photo_from_anchor=photo_from_anchor,
        gain=float(gain),
        bias=float(bias),
        residual=float(sigma),
        pixels=int(np.count_nonzero(usable)),
        motion_pixels=motion_of(template, photo_from_anchor),
        iterations=iterations,
        converged=converged,
    )


def _rest_of_steps(before: Float64Array, step: Float64Array, motion: Float64Array) -> float:
    """What follows a step, as a multiple of it: the sum of a geometric series, whose factor is the
    step's part along the one before (Aitken). 0 where the steps do not shrink that way."""
    factor = float(step[:6] @ motion @ before[:6]) / float(before[:6] @ motion @ before[:6])
    return factor / (1.0 - factor) if 0.0 < factor < _MOST_ALIKE else 0.0


def _normal_equations(
    template: Template,
    residuals: Float32Array,
    usable: BoolArray,
    gain: float,
    sigma: float,
    settings: LucasKanadeSettings,
) -> tuple[Float64Array, Float64Array]:
    """Left and right side of a step's equations, (U, U) and (U,)."""
    unknowns = 8 if settings.gain_and_bias else 6
    loops = compiled_loops()
    if loops is not None:
        cutoff = TUKEY_CUTOFF * sigma if settings.robust else np.inf
        hessian, right = loops.normal_equations(
            template.jacobian, template.intensities, residuals, usable, gain, cutoff
        )
        return hessian[:unknowns, :unknowns], right[:unknowns]
    weights = (tukey_weights(residuals, sigma) if settings.robust else np.float32(1.0)) * usable
    design = np.empty((len(residuals), 8), dtype=np.float32)
    np.multiply(template.jacobian, np.float32(gain), out=design[:, :6])
    design[:, 6], design[:, 7] = template.intensities, 1.0
    weighted = design[:, :unknowns] * weights[:, None]
    hessian = (weighted.T @ design[:, :unknowns]).astype(np.float64)
    return hessian, (weighted.T @ residuals).astype(np.float64)


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


def _solve(hessian: Float64Array, right: Float64Array) -> Float64Array | None:
    """Solves with unit-free columns, or None when a direction is not observed at all."""
    scale = np.sqrt(np.diag(hessian))
    if np.any(scale <= 0) or not np.all(np.isfinite(hessian)):
        return None
    scaled = hessian / np.outer(scale, scale)
    try:
        return np.asarray(np.linalg.solve(scaled, right / scale) / scale)
    except np.linalg.LinAlgError:
        return None
