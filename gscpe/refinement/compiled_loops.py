# SPDX-License-Identifier: Apache-2.0
"""The solver's loops over pixels, compiled by Numba: several times faster than NumPy, in one
thread, and without Python's lock, so that another thread may render meanwhile.

They do what ``template.py``, ``lucas_kanade.py``, ``products.py`` and ``visibility.py`` say in
NumPy, which is used where Numba is not installed. Arrays are made here; ``kernels.py`` fills them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import BoolArray, Float32Array, Float64Array, IntArray
from gscpe.geometry.camera import Camera
from gscpe.interrupts import interrupts_later
from gscpe.refinement import kernels

_F = np.float32


def inner_products(a: Float32Array, b: Float32Array) -> Float64Array:
    """As :func:`gscpe.refinement.products.inner_products`."""
    product = np.empty((len(a), len(b)))
    kernels.inner_products(np.ascontiguousarray(a), np.ascontiguousarray(b), product)
    return product


def weighted_squares(rows: Float32Array, weights: Float32Array) -> Float64Array:
    """As :func:`gscpe.refinement.products.weighted_squares`."""
    product = np.zeros((len(rows), len(rows)))
    kernels.weighted_squares(np.ascontiguousarray(rows), np.ascontiguousarray(weights), product)
    return product + np.triu(product, 1).T


def sums_by_label(labels: IntArray, rows: Float32Array, count: int) -> Float64Array:
    """As :func:`gscpe.refinement.products.sums_by_label`."""
    sums = np.zeros((len(rows), count))
    kernels.sums_by_label(labels, np.ascontiguousarray(rows), sums)
    return sums


def combined(matrix: Float32Array, rows: Float32Array) -> Float32Array:
    """As :func:`gscpe.refinement.products.combined`."""
    product = np.empty((len(matrix), rows.shape[1]), dtype=np.float32)
    kernels.combined(np.ascontiguousarray(matrix), np.ascontiguousarray(rows), product)
    return product


def residuals_of(
    points: Float32Array,
    intensities: Float32Array,
    image: Float32Array,
    valid: BoolArray,
    photo_from_anchor: Float64Array,
    camera: Camera,
    gain: float,
    bias: float,
) -> tuple[Float32Array, BoolArray]:
    """As :func:`gscpe.refinement.template.residuals_of`."""
    residuals = np.empty(len(intensities), dtype=np.float32)
    usable = np.empty(len(intensities), dtype=np.bool_)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32)
    kernels.residuals(
        *(points, intensities, image, valid, photo_from_anchor[:3].astype(np.float32), lens),
        *(np.array([gain, bias], dtype=np.float32), residuals, usable),
    )
    return residuals, usable


def template_of(
    image: Float32Array, depth: Float32Array, camera: Camera, chosen: IntArray
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Points, (3, N), intensities, (N,), and Jacobian, (N, 6), of pixels of an anchor, as
    :class:`gscpe.refinement.template.Template` has them.

    Args:
        image, depth: (H, W).
        camera: of both.
        chosen: (N,) flat indices of pixels, none at the border.
    """
    points = np.empty((3, len(chosen)), dtype=np.float32)
    intensities = np.empty(len(chosen), dtype=np.float32)
    jacobian = np.empty((len(chosen), 6), dtype=np.float32)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32)
    image, depth = np.ascontiguousarray(image), np.ascontiguousarray(depth)
    kernels.template(chosen, image, depth, lens, points, intensities, jacobian)
    return points, intensities, jacobian


def thinned(indices: IntArray, end: int) -> IntArray:
    """Those whose place in a Weyl sequence of 32 bits is before ``end``."""
    kept = np.empty_like(indices)
    return kept[: kernels.thinned(indices, np.uint64(end), kept)].copy()


def normal_equations(
    jacobian: Float32Array,
    intensities: Float32Array,
    residuals: Float32Array,
    usable: BoolArray,
    gain: float,
    cutoff: float,
) -> tuple[Float64Array, Float64Array]:
    """Of a step, (8, 8) and (8,), with Tukey's weights that end at the cutoff; infinite: all
    weigh alike."""
    hessian, right = np.zeros((8, 8)), np.zeros(8)
    kernels.normal_equations(
        *(jacobian, intensities, residuals, usable, _F(gain), _F(1.0 / cutoff), hessian, right)
    )
    return hessian + np.triu(hessian, 1).T, right


def vote(
    depth: Float32Array,
    camera: Camera,
    mask: BoolArray,
    view_camera: Camera,
    view_from_anchor: Float64Array,
    nearest: Float32Array,
    farthest: Float32Array,
    known: BoolArray,
    tolerance: float,
    seen: NDArray[np.uint16],
    votes: NDArray[np.uint16],
) -> None:
    """As :func:`gscpe.refinement.visibility._vote`.

    Args:
        depth: (H, W) of the anchor.
        camera: of the anchor.
        mask: (H, W), pixels of the anchor that are voted on.
        view_camera: of the view, h x w pixels.
        view_from_anchor: (4, 4).
        nearest, farthest: (h, w), range of the view's depth around each of its pixels.
        known: (h, w), where the view shows something.
        tolerance: by which depths may differ; in the unit of the depths.
        seen, votes: (H, W), counted up in place.
    """
    lens, view_lens = (np.array([c.fx, c.fy, c.cx, c.cy]) for c in (camera, view_camera))
    pose = np.ascontiguousarray(view_from_anchor[:3])
    kernels.vote(
        *(np.ascontiguousarray(depth), lens, mask, view_lens, pose),
        *(nearest, farthest, known, tolerance, seen, votes),
    )


def compile_now() -> None:
    """Compiles the loops, or loads them from Numba's cache. An interrupt waits: in Numba's
    compiler it would be lost."""
    with interrupts_later():
        points = np.ones((3, 1), dtype=np.float32)
        image, ones = np.ones((2, 2), dtype=np.float32), np.ones(1, dtype=np.float32)
        camera = Camera.pinhole(2, 2, fx=1.0, fy=1.0, cx=1.0, cy=1.0)
        residuals, usable = residuals_of(
            points, ones, image, np.ones((2, 2), dtype=np.bool_), np.eye(4), camera, 1.0, 0.0
        )
        jacobian = np.ones((1, 6), dtype=np.float32)
        template_of(
            np.ones((3, 3), dtype=np.float32),
            np.ones((3, 3), dtype=np.float32),
            camera,
            thinned(np.array([4]), 2**32),
        )
        normal_equations(jacobian, ones, residuals, usable, 1.0, np.inf)
        inner_products(points, points)
        combined(points, points.T)
        weighted_squares(points, ones)
        sums_by_label(np.zeros(1, dtype=np.intp), points, 1)
        everywhere = np.ones((2, 2), dtype=np.bool_)
        counts = np.zeros((2, 2), dtype=np.uint16)
        vote(
            image, camera, everywhere, camera, np.eye(4),
            image, image, everywhere, 0.0, counts, counts.copy(),
        )  # fmt: skip
