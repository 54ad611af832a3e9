# SPDX-License-Identifier: Apache-2.0
"""How sure an alignment is, judged by what it could not explain.

Where photo and render differ, they differ over whole regions: the map is a little off there, or
the light has changed. So pixels are not independent, and the covariance of independent ones is
far too small. The sandwich estimator takes the differences as they are (Huber, "Robust
Statistics", 1981; with blocks: Liang and Zeger, Biometrika 1986): with ``s_b`` the sum over a
block of ``w r J``,

    C = H^-1 (sum_b s_b s_b^T) H^-1 / c^2,      H = sum w J J^T

where c corrects H, made of weights, for the curvature of the robust loss. What is correlated
beyond a block, such as a bent map, is not seen in it: C grows with the square root of rho, by
which the blocks' sums exceed those of independent pixels. And gradients that noise makes are no
evidence, though H counts them: along stripes they would promise what nothing can tell. But the
render's noise is not the photo's, so only what the gradients of both share is counted, and only
where it cannot be chance. Measured on four kinds of scenes: docs/benchmarks.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gscpe.arrays import Float32Array, Float64Array, IntArray
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.information import covariance_from_information
from gscpe.ranges import check_numbers, check_shares, check_whole
from gscpe.refinement.lucas_kanade import (
    Alignment,
    LucasKanadeSettings,
    Template,
    residuals_of,
)
from gscpe.refinement.products import (
    combined,
    inner_products,
    sums_by_label,
    weighted_squares,
)
from gscpe.refinement.pyramid import ImageLevel
from gscpe.refinement.robust import tukey_curvature, tukey_weights
from gscpe.refinement.sampling import gradient

_LEAST_CURVATURE = 0.1
"""Where most residuals are beyond the kernel's bend, the curvature says nothing."""
_LEAST_KEPT = 1e-6
"""Share of the information of a direction, so that what is all noise keeps a finite variance."""

_GRAIN = 4
"""Pixels, across which the noise of a photo (demosaicked, compressed) or of a render may hang
together."""
_SIGNIFICANT = 4.0
"""Standard deviations by which shared gradients must stand out from chance."""


@dataclass(frozen=True, eq=False)
class PoseUncertainty:
    """Of xi in ``exp(xi) @ photo_from_anchor``, (translation, rotation).

    Attributes:
        covariance: (6, 6).
        unshared: (6, 6), the part of it that is there because photo and render show hardly any
            gradients in common along some direction: nothing in usual scenes, very much along
            stripes. Whoever compares the two images, by whatever means, knows no better.
        by_log_focal: (6,) how the pose follows the logarithm of the photo's focal lengths, which
            the covariance takes as exact.
        by_principal: (6, 2) ... and its principal point, whose coordinates are counted in focal
            lengths.
    """

    covariance: Float64Array
    unshared: Float64Array
    by_log_focal: Float64Array
    by_principal: Float64Array


@dataclass(frozen=True)
class UncertaintySettings:
    """Settings of the covariance.

    Attributes:
        blocks: a block is the photo's width divided by this.
        shrinkage: there are few blocks beside the 36 numbers that they determine, so this
            share of them is replaced by their mean, the shape being that of H.
        factor: the covariance is multiplied by it (calibrated, docs/benchmarks.md).
        enough_shared: share of a direction's gradient information that both images must have in
            common, so that matches can determine this direction too; below half of it they cannot
            at all.
        least_pixels: motions that move the picture by less (root mean square) are below the errors
            of rendering and interpolation.

    Raises:
        SettingsError: a value is out of its range.
    """

    blocks: int = 10
    shrinkage: float = 0.5
    factor: float = 2.5
    enough_shared: float = 0.3
    least_pixels: float = 0.004

    def __post_init__(self) -> None:
        check_whole(self, "blocks", least=1)
        check_shares(self, "shrinkage")
        check_numbers(self, "factor", above=0)
        check_numbers(self, "enough_shared", above=0, most=1)
        check_numbers(self, "least_pixels", least=0)


def pose_uncertainty(
    template: Template,
    photo: ImageLevel,
    alignment: Alignment,
    solver: LucasKanadeSettings,
    settings: UncertaintySettings,
) -> PoseUncertainty:
    """How sure ``photo_from_anchor`` is.

    Args:
        template, photo, solver: that were aligned.
        alignment: what came of it.
        settings: see :class:`UncertaintySettings`.
    """
    residuals, usable = residuals_of(
        template, photo, alignment.photo_from_anchor, alignment.gain, alignment.bias
    )
    weights, curvatures = usable.astype(np.float32), usable.astype(np.float32)
    if solver.robust:
        weights *= tukey_weights(residuals, alignment.residual)
        curvatures *= tukey_curvature(residuals, alignment.residual)
    unknowns = 8 if solver.gain_and_bias else 6
    light = np.stack([template.intensities, np.ones_like(residuals)])
    gain = np.float32(alignment.gain)
    design = np.concatenate([gain * template.jacobian.T, light])[:unknowns]
    hessian = weighted_squares(design, weights)
    inverse = covariance_from_information(hessian)
    pulls = weights * residuals
    blocks = blocks_of(template, photo.camera, settings.blocks)
    sums = sums_by_label(blocks, design * pulls)
    between, within = sums @ sums.T, weighted_squares(design, pulls * pulls)

    # Eight-bit photos are not better known than that, however well the render fits.
    least = solver.min_noise**2
    mean = max(float(np.trace(inverse @ between)) / unknowns, least)
    rho = max(mean / max(float(np.trace(inverse @ within)) / unknowns, least), 1.0)
    curved = weighted_squares(design, curvatures)
    curvature = max(float(np.trace(inverse @ curved)) / unknowns, _LEAST_CURVATURE)
    middle = (1.0 - settings.shrinkage) * between + settings.shrinkage * mean * hessian
    factor = settings.factor * np.sqrt(rho) / curvature**2
    root = np.asarray(np.linalg.cholesky(inverse), dtype=np.float64)
    seen = design.copy()
    seen[:6] = _photo_jacobian(template, photo, alignment)
    grains = blocks_of(template, photo.camera, max(1, photo.camera.width // _GRAIN))
    kept, axes = _shared_information(design, seen, weights, root, grains)
    whole = factor * (root.T @ middle @ root)
    to_photo = se3.adjoint(alignment.photo_from_anchor)

    def of_pose(scales: Float64Array) -> Float64Array:
        half = root @ (axes * scales) @ axes.T
        of_anchor = (half @ whole @ half.T)[:6, :6]
        return np.asarray(to_photo @ of_anchor @ to_photo.T)

    floor = settings.least_pixels**2 * covariance_from_information(template.motion)
    covariance = of_pose(1.0 / np.sqrt(kept)) + to_photo @ floor @ to_photo.T
    # All of it where hardly anything is shared, nothing where enough is.
    blind = np.clip(2.0 - kept / (0.5 * settings.enough_shared), 0.0, 1.0)
    unshared = of_pose(np.sqrt(blind * (1.0 / kept - 1.0)))
    # A longer lens moves a point at x, y, z by (x, y) / z: the template's by_x x + by_y y.
    # A principal point that is off moves all points alike, as if by their depth.
    by_camera = np.ascontiguousarray(gain * template.jacobian[:, :3].T * template.points[2])
    by_camera[2] *= -1.0
    right = inner_products(design * weights, by_camera)
    by_intrinsics = -to_photo @ (inverse @ right)[:6]
    return PoseUncertainty(
        _symmetric(covariance), _symmetric(unshared), by_intrinsics[:, 2], by_intrinsics[:, :2]
    )


def _shared_information(
    design: Float32Array,
    seen: Float32Array,
    weights: Float32Array,
    root: Float64Array,
    grains: IntArray,
) -> tuple[Float64Array, Float64Array]:
    """The share of the information that the gradients of both images have in common, (U,), along
    orthogonal axes of the whitened unknowns, the columns of (U, U).

    Noise that the images do not share adds to a sum of products as much as it takes away, give or
    take the root of the sum of the squares; a share that may be that is none.
    """
    shared = root.T @ _symmetric(inner_products(seen * weights, design)) @ root
    axes = np.asarray(np.linalg.eigh(shared)[1])
    whitened = (root @ axes).T.astype(np.float32)
    products = weights * combined(whitened, design) * combined(whitened, seen)
    sums = sums_by_label(grains, products)
    chance = _SIGNIFICANT * np.sqrt(np.sum(sums**2, axis=1))
    share = sums.sum(axis=1)
    kept = np.sqrt(np.maximum(share**2 - chance**2, 0.0)) * (share > 0)
    return np.clip(kept, _LEAST_KEPT, 1.0), axes


def _symmetric(matrix: Float64Array) -> Float64Array:
    return np.asarray(0.5 * (matrix + matrix.T))


def _photo_jacobian(template: Template, photo: ImageLevel, alignment: Alignment) -> Float32Array:
    """As the template's, (6, N), but of the photo's own gradients where its points are seen."""
    photo_from_anchor = alignment.photo_from_anchor
    by_u, by_v = (
        residuals_of(template, replace(photo, image=image), photo_from_anchor, 0.0, 0.0)[0]
        for image in gradient(photo.image)
    )
    rotation, shift = np.split(photo_from_anchor[:3].astype(np.float32), [3], axis=1)
    x, y, z = combined(rotation, template.points) + shift
    z = np.maximum(z, np.float32(1e-3))
    by_x, by_y = by_u * np.float32(photo.camera.fx) / z, by_v * np.float32(photo.camera.fy) / z
    by_moved = np.stack([by_x, by_y, -(by_x * x + by_y * y) / z])
    by_point = combined(rotation.T, by_moved)
    (x, y, z), (a, b, c) = template.points, by_point
    return np.stack([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a])


def blocks_of(template: Template, camera: Camera, count: int) -> IntArray:
    """A number for each template point's block of the anchor image, (N,)."""
    x, y, z = template.points
    size = np.float32(camera.width / count)
    column = (x / z * np.float32(camera.fx) + np.float32(camera.cx)) / size
    row = (y / z * np.float32(camera.fy) + np.float32(camera.cy)) / size
    column = np.clip(column.astype(np.intp), 0, count - 1)
    return np.asarray(np.maximum(row.astype(np.intp), 0) * count + column)
