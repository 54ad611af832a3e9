# SPDX-License-Identifier: Apache-2.0
"""How sure an alignment is, judged by what it could not explain.

Where photo and render differ, they differ over whole regions: the map is a little off there, or
the light has changed. So pixels are not independent, and the covariance of independent ones is
far too small. The sandwich estimator takes the differences as they are (Huber, "Robust
Statistics", 1981):

    C = A^-1 B A^-T,    A = sum psi'(r) J J_photo^T,    B = sum_bc k(b, c) s_b s_c^T

A is how the sum of ``psi(r) J``, which the alignment makes zero, follows the pose: psi' is the
slope of the robust loss's influence, and what a residual follows is the photo's own gradient. B is
how far that sum strays by itself: ``s_b`` is its part in a block of the image, and k falls from 1
within a block to 0 at some blocks' distance, so that correlation is measured in the very photo as
far as that (Newey and West, Econometrica 1987; in space: Conley, J. Econometrics 1999). As the
sum is zero, B misses as much of it as the kernel covers of the image, and is made larger by that.
What is correlated farther, such as a bent map, cannot be told from a pose that is a little off.

Gradients that noise makes are no evidence: along stripes they would promise what nothing can
tell. But the render's noise is not the photo's, so only what the gradients of both share is
counted, and only where it cannot be chance. Measured on several scenes: docs/benchmarks.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gscpe.arrays import Float32Array, Float64Array, IntArray
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.geometry.information import covariance_from_information
from gscpe.geometry.intrinsics import moved_by_intrinsics
from gscpe.ranges import check_numbers, check_shares, check_whole
from gscpe.refinement.lucas_kanade import Alignment
from gscpe.refinement.products import (
    combined,
    inner_products,
    sums_by_label,
    weighted_squares,
)
from gscpe.refinement.pyramid import ImageLevel
from gscpe.refinement.robust import tukey_curvature, tukey_weights
from gscpe.refinement.sampling import gradient
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.template import Template, residuals_of

_LEAST_SLOPE = 0.1
"""Of the influence, as a share of the weight: where most residuals are beyond the bend of the loss,
it says nothing."""
_LEAST_KEPT = 1e-4
"""Share of the information of a direction, so that what is all noise keeps a finite variance."""
_LEAST_SEEN = 0.25
"""Share of B that is not missed, at least: a few blocks of a photo that is mostly covered."""

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
        by_camera: (6, 5) how the pose follows the five numbers of the photo's camera, see
            ``Camera.covariance``, which this covariance takes as exact.
    """

    covariance: Float64Array
    unshared: Float64Array
    by_camera: Float64Array


@dataclass(frozen=True)
class UncertaintySettings:
    """Settings of the covariance.

    Attributes:
        blocks: a block is the photo's width divided by this.
        reach: blocks' distance, along rows and columns, at which nothing is correlated any more.
        shrinkage: there are few blocks beside the 36 numbers that they determine, so this
            share of them is replaced by their mean, the shape being that of independent pixels.
        factor: the covariance is multiplied by it.
        enough_shared: share of a direction's gradient information that both images must have in
            common, so that matches can determine this direction too; below half of it they cannot
            at all.
        least_pixels: standard deviation of motions, along each of six axes, that move the picture
            by so much (root mean square), for what residuals do not show: a bent map, rendering and
            interpolation (calibrated, docs/benchmarks.md).

    Raises:
        SettingsError: a value is out of its range.
    """

    blocks: int = 10
    reach: float = 3.0
    shrinkage: float = 0.2
    factor: float = 1.0
    enough_shared: float = 0.3
    least_pixels: float = 0.05

    def __post_init__(self) -> None:
        check_whole(self, "blocks", least=1)
        check_shares(self, "shrinkage")
        check_numbers(self, "factor", above=0)
        check_numbers(self, "enough_shared", above=0, most=1)
        check_numbers(self, "least_pixels", least=0)
        check_numbers(self, "reach", least=1)


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
    weights, slopes = usable.astype(np.float32), usable.astype(np.float32)
    if solver.robust:
        weights *= tukey_weights(residuals, alignment.residual)
        slopes *= tukey_curvature(residuals, alignment.residual)
    unknowns = 8 if solver.gain_and_bias else 6
    light = np.stack([template.intensities, np.ones_like(residuals)])
    gain = np.float32(alignment.gain)
    design = np.concatenate([gain * template.jacobian.T, light])[:unknowns]
    seen = design.copy()
    seen[:6] = _photo_jacobian(template, photo, alignment)
    hessian = weighted_squares(design, weights)
    inverse = covariance_from_information(hessian)
    root = np.asarray(np.linalg.cholesky(inverse), dtype=np.float64)

    blocks = blocks_of(template, photo.camera, settings.blocks)
    rows = np.concatenate([design * (weights * residuals), weights[None]])
    strayed = root.T @ _between_blocks(sums_by_label(blocks, rows), settings) @ root
    # Eight-bit photos are not better known than that, however well the render fits.
    mean = max(float(np.trace(strayed)) / unknowns, solver.min_noise**2)
    middle = (1.0 - settings.shrinkage) * strayed + settings.shrinkage * mean * np.eye(unknowns)

    grains = blocks_of(template, photo.camera, max(1, photo.camera.width // _GRAIN))
    shared = _shared_information(design, seen, weights, slopes, root, grains)
    axes, kept = shared.axes, shared.kept
    middle = settings.factor * (axes.T @ middle @ axes)
    to_photo = se3.adjoint(alignment.photo_from_anchor)

    def of_pose(scales: Float64Array) -> Float64Array:
        """Of what moves along each axis by so much more than the slopes say."""
        half = root @ (axes * scales) @ shared.inverse_slope * np.sqrt(1.0 / kept)
        of_anchor = (half @ middle @ half.T)[:6, :6]
        return np.asarray(to_photo @ of_anchor @ to_photo.T)

    floor = settings.least_pixels**2 * covariance_from_information(template.motion)
    covariance = of_pose(np.sqrt(1.0 / kept)) + to_photo @ floor @ to_photo.T
    # All of it where hardly anything is shared, nothing where enough is.
    blind = np.clip(2.0 - kept / (0.5 * settings.enough_shared), 0.0, 1.0)
    unshared = of_pose(np.sqrt(blind / kept))
    right = inner_products(design * weights, moved_by_camera(template, alignment.gain))
    by_camera = -to_photo @ (inverse @ right)[:6]
    return PoseUncertainty(_symmetric(covariance), _symmetric(unshared), by_camera)


def moved_by_camera(template: Template, gain: float) -> Float32Array:
    """How residuals follow the numbers of the photo's camera (``Camera.covariance``), (5, N)."""
    # The template's slopes times depth are those by x / z and y / z: by moves in focal lengths.
    by_x, by_y = np.float32(gain) * template.jacobian[:, :2].T * template.points[2]
    moved = moved_by_intrinsics(*(template.points[:2] / template.points[2]))
    return np.ascontiguousarray(moved[:, 0] * by_x + moved[:, 1] * by_y, dtype=np.float32)


def _between_blocks(sums: Float64Array, settings: UncertaintySettings) -> Float64Array:
    """B, (U, U), of the blocks' sums, (U + 1, blocks); the last row is of the weights."""
    row, column = np.divmod(np.arange(sums.shape[1]), settings.blocks)
    kernel = np.ones((len(row), len(row)))
    for place in (row, column):
        kernel *= np.maximum(1.0 - np.abs(place[:, None] - place) / settings.reach, 0.0)
    pulls, weights = sums[:-1], sums[-1] / max(float(sums[-1].sum()), 1e-12)
    missed = float(weights @ kernel @ weights)
    return np.asarray(pulls @ kernel @ pulls.T / max(1.0 - missed, _LEAST_SEEN))


@dataclass(frozen=True, eq=False)
class _Shared:
    """What the gradients of both images share.

    Attributes:
        axes: (U, U), its columns are orthogonal axes of the whitened unknowns.
        kept: (U,) share of the information that both have along them, of that of the template.
        inverse_slope: (U, U) inverse of A along the axes, were all of it shared.
    """

    axes: Float64Array
    kept: Float64Array
    inverse_slope: Float64Array


def _shared_information(
    design: Float32Array,
    seen: Float32Array,
    weights: Float32Array,
    slopes: Float32Array,
    root: Float64Array,
    grains: IntArray,
) -> _Shared:
    """Noise that the images do not share adds to a sum of products as much as it takes away, give
    or take the root of the sum of the squares; a share that may be that is none.
    """
    shared = root.T @ _symmetric(inner_products(seen * weights, design)) @ root
    axes = np.asarray(np.linalg.eigh(shared)[1])
    whitened = (root @ axes).T.astype(np.float32)
    design, seen = combined(whitened, design), combined(whitened, seen)
    sums = sums_by_label(grains, weights * design * seen)
    chance = _SIGNIFICANT * np.sqrt(np.sum(sums**2, axis=1))
    share = sums.sum(axis=1)
    kept = np.sqrt(np.maximum(share**2 - chance**2, 0.0)) * (share > 0)
    kept = np.clip(kept, _LEAST_KEPT, 1.0)
    # Where nothing is shared, slopes are of noise and say nothing.
    known = kept > _LEAST_KEPT
    size = np.sqrt(np.where(known, share, 1.0))
    slope = _symmetric(inner_products(design * slopes, seen)) / np.outer(size, size)
    slope = np.where(np.outer(known, known), slope, np.eye(len(known)))
    values, vectors = np.linalg.eigh(slope)
    inverse = (vectors / np.maximum(values, _LEAST_SLOPE)) @ vectors.T
    return _Shared(axes, kept, np.asarray(inverse))


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
