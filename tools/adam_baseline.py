# SPDX-License-Identifier: Apache-2.0
"""The paper's optimizer of the pose, as a baseline for tools/bench_refinement.py: Adam.

Kingma and Ba, "Adam: a method for stochastic optimization" (ICLR 2015), on the seven numbers of
``photo_from_anchor``: a unit quaternion and a translation. What the paper does not say was chosen:
the pose is relative to the anchor (so that turning does not move the camera), moments start anew
at every level, the loss is the mean squared difference of luminance, and the photo's gradients
are exact, as automatic differentiation would have them.

Renders, masks, pyramids and the thinned template are those of gscpe.refinement (the template
brings a Jacobian that Adam does not need: 2 to 4% of the solver's time). After each level
but the last the anchor is rendered anew when the pose has left it (Algorithm 2), by 0.5 cm or
0.5 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array
from gscpe.geometry import pose_difference, se3
from gscpe.photos import Photo, luminance
from gscpe.refinement import RefinementObserver, RefinementSettings
from gscpe.refinement.pyramid import ImageLevel, anchor_pyramid, photo_pyramid
from gscpe.refinement.sampling import corners
from gscpe.refinement.template import Template, build_template, warp
from gscpe.refinement.visibility import visibility_mask
from gscpe.render import Renders

_REDONE_METRES, _REDONE_DEGREES = 0.005, 0.5
"""The paper's thresholds of a new render: 0.5 (no unit given, taken as cm) and 0.5 degrees."""

Loss = Literal["l1", "l2"]


@dataclass(frozen=True)
class AdamSettings:
    """The paper's, where it gives one.

    Attributes:
        learning_rate: of all seven numbers (map units for the translation).
        beta1, beta2, epsilon: Adam's own defaults.
        iterations: at each level.
        loss: of the luminance in the masked pixels: "l2" is its mean squared difference, "l1"
            the mean of its absolute difference.
        refinement: levels S, mask, thresholds to render anew; its solver thins the template.
    """

    learning_rate: float = 3e-4
    beta1: float = 0.9
    beta2: float = 0.999
    epsilon: float = 1e-8
    iterations: int = 20
    loss: Loss = "l2"
    refinement: RefinementSettings = field(default_factory=RefinementSettings)


class Adam:
    """Steps of a vector, (N,), against its gradient."""

    def __init__(self, settings: AdamSettings, size: int) -> None:
        self._settings = settings
        self._first, self._second = np.zeros(size), np.zeros(size)
        self._count = 0

    def step(self, gradient: Float64Array) -> Float64Array:
        s = self._settings
        self._count += 1
        self._first = s.beta1 * self._first + (1 - s.beta1) * gradient
        self._second = s.beta2 * self._second + (1 - s.beta2) * gradient**2
        first = self._first / (1 - s.beta1**self._count)
        second = self._second / (1 - s.beta2**self._count)
        return np.asarray(-s.learning_rate * first / (np.sqrt(second) + s.epsilon))


def refine_by_adam(
    renderer: Renders,
    photo: Photo,
    start_cam_from_world: Float64Array,
    settings: AdamSettings,
    observer: RefinementObserver,
) -> Float64Array:
    """The pose, (4, 4), by Adam in the place of Lucas-Kanade; arguments as of
    :func:`gscpe.refinement.refine_pose`."""
    refinement = settings.refinement
    valid = np.ones(photo.rgb.shape[:2], dtype=bool) if photo.valid is None else photo.valid
    photos = photo_pyramid(luminance(photo.rgb), valid, photo.camera, refinement.levels)
    cam_from_world = start_cam_from_world
    anchors = None
    for level in range(refinement.levels, -1, -1):
        if anchors is None:
            view = renderer.render(photo.camera, cam_from_world)
            observer.anchor_rendered(view)
            mask = visibility_mask(renderer, view, refinement.visibility, view.tolerance_unit())
            observer.mask_made(mask)
            anchors = anchor_pyramid(
                luminance(view.rgb), view.depth, mask, view.camera, level, refinement.lenient_level
            )
        template = build_template(anchors[level], refinement.solver)
        if template is None:
            continue
        photo_from_anchor = cam_from_world @ se3.inverse(view.cam_from_world)
        parameters = np.concatenate(se3.to_quaternion_translation(photo_from_anchor))
        adam = Adam(settings, len(parameters))
        for _ in range(settings.iterations):
            _, gradient = photometric_loss(template, photos[level], parameters, settings.loss)
            parameters = parameters + adam.step(gradient)
            parameters[:4] /= np.linalg.norm(parameters[:4])
            observer.iterated(_transform(parameters))
        cam_from_world = _transform(parameters) @ view.cam_from_world
        moved = pose_difference(cam_from_world, view.cam_from_world)
        if moved.distance > (refinement.rerender_translation or _REDONE_METRES) or moved.degrees > (
            refinement.rerender_rotation_degrees or _REDONE_DEGREES
        ):
            anchors = None
    return cam_from_world


def photometric_loss(
    template: Template, photo: ImageLevel, parameters: Float64Array, loss: Loss
) -> tuple[float, Float64Array]:
    """The loss over the template's pixels that the photo shows, and its gradient, (7,).

    Args:
        template: points and intensities of the anchor.
        photo: the photo at the same level.
        parameters: (7,) qw qx qy qz tx ty tz of photo_from_anchor; the loss does not depend
            on the quaternion's length, so the gradient is orthogonal to it.
        loss: see :class:`AdamSettings`.
    """
    transform = _transform(parameters)
    camera = photo.camera
    u, v, ahead = warp(template.points, transform, camera)
    values, by_u, by_v, inside = sample_with_gradient(photo, u, v)
    used = np.flatnonzero(inside & ahead)
    if not len(used):
        return 0.0, np.zeros(7)
    points = template.points[:, used]
    residuals = values[used] - template.intensities[used]
    if loss == "l2":
        value, slope = np.mean(residuals**2, dtype=np.float64), 2.0 * residuals / len(used)
    else:
        value, slope = np.mean(np.abs(residuals), dtype=np.float64), np.sign(residuals) / len(used)
    x, y, z = transform[:3, :3].astype(np.float32) @ points + transform[:3, 3, None]
    by_x = slope * by_u[used] * camera.fx / z
    by_y = slope * by_v[used] * camera.fy / z
    by_point = np.stack([by_x, by_y, -(by_x * x + by_y * y) / z])
    by_rotation = (by_point @ points.T).astype(np.float64)
    by_quaternion = quaternion_gradient(parameters[:4], by_rotation)
    return float(value), np.concatenate([by_quaternion, by_point.sum(axis=1)])


def _transform(parameters: Float64Array) -> Float64Array:
    return se3.from_quaternion_translation(parameters[:4], parameters[4:])


def quaternion_gradient(quaternion_wxyz: Float64Array, by_rotation: Float64Array) -> Float64Array:
    """d f / d q, (4,), of f(R(q / |q|)), from d f / d R, (3, 3)."""
    length = float(np.linalg.norm(quaternion_wxyz))
    unit = quaternion_wxyz / length
    w, v = unit[0], unit[1:]
    g = by_rotation
    # R = (w^2 - v.v) I + 2 v v^T + 2 w [v]x, and <g, [v]x> = axial . v
    axial = np.array([g[2, 1] - g[1, 2], g[0, 2] - g[2, 0], g[1, 0] - g[0, 1]])
    by_w = 2 * w * np.trace(g) + 2 * v @ axial
    by_v = -2 * v * np.trace(g) + 2 * (g + g.T) @ v + 2 * w * axial
    by_unit = np.array([by_w, *by_v])
    return np.asarray((by_unit - unit * (unit @ by_unit)) / length)


def sample_with_gradient(
    photo: ImageLevel, u: Float32Array, v: Float32Array
) -> tuple[Float32Array, Float32Array, Float32Array, BoolArray]:
    """:func:`gscpe.refinement.sampling.sample_bilinear` and the derivatives of the values, (N,)
    each, by u and v: those of the interpolation, so exact but at the pixel centres."""
    at = corners(photo.image, photo.valid, u, v)
    a, b = at.right.astype(np.float32), at.down.astype(np.float32)
    across_upper = at.upper_right - at.upper_left
    across_lower = at.lower_right - at.lower_left
    upper, lower = at.upper_left + a * across_upper, at.lower_left + a * across_lower
    by_u = (1 - b) * across_upper + b * across_lower
    return upper + b * (lower - upper), by_u, lower - upper, at.inside
