# SPDX-License-Identifier: Apache-2.0
"""Inverse-compositional Lucas-Kanade over SE(3), gain and bias (design: docs/how-it-works.md).

Baker and Matthews, "Lucas-Kanade 20 years on" (IJCV 2004), with a rendered template that
knows its depth. The anchor a is the render, the photo is q, and T, ``photo_from_anchor``, is
sought. With residuals r and Jacobians J as in ``template.py``:

    step      min sum w (r - [gain J, I_a, 1] (delta, d_gain, d_bias))^2
    update    T <- T exp(delta)^-1
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable

import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array, short_repr
from gscpe.geometry import se3
from gscpe.refinement.products import compiled_loops
from gscpe.refinement.pyramid import ImageLevel
from gscpe.refinement.robust import TUKEY_CUTOFF, robust_sigma, tukey_weights
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.template import Template, motion_of, residuals_of

_MOST_ALIKE = 0.75
"""Factor from one step to the next beyond which nothing is extrapolated."""


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
