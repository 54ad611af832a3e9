# SPDX-License-Identifier: Apache-2.0
"""The solver's loops over pixels, compiled by Numba: several times faster than NumPy, in one
thread, and without Python's lock, so that another thread may render meanwhile.

They do what ``lucas_kanade.py`` says in NumPy, which is used where Numba is not installed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gscpe.arrays import BoolArray, Float32Array, Float64Array, IntArray
from gscpe.geometry.camera import Camera
from gscpe.interrupts import interrupts_later
from gscpe.render.compiled import compiled

_F = np.float32
_BLOCK = 128
_NEAREST = _F(1e-3)


@compiled(fastmath={"contract"})
def _residuals(points, intensities, image, valid, pose, camera, light, residuals, usable):
    """Fills residuals and usable, (N,) each; returns how many are usable."""
    height, width = image.shape
    right, bottom = _F(width - 1), _F(height - 1)
    fx, fy, cx, cy = camera[0], camera[1], camera[2] - _F(0.5), camera[3] - _F(0.5)
    gain, bias = light[0], light[1]
    count = 0
    for i in range(intensities.shape[0]):
        residuals[i] = _F(0.0)
        usable[i] = False
        x, y, z = points[0, i], points[1, i], points[2, i]
        ahead = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if not ahead > _NEAREST:
            continue
        inverse = _F(1.0) / ahead
        u = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) * inverse * fx + cx
        v = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) * inverse * fy + cy
        if not (u >= _F(0.0) and v >= _F(0.0) and u < right and v < bottom):
            continue
        left, top = np.intp(u), np.intp(v)
        if not (valid[top, left] and valid[top, left + 1]):
            continue
        if not (valid[top + 1, left] and valid[top + 1, left + 1]):
            continue
        a, b = u - _F(left), v - _F(top)
        upper = image[top, left] + a * (image[top, left + 1] - image[top, left])
        lower = image[top + 1, left] + a * (image[top + 1, left + 1] - image[top + 1, left])
        residuals[i] = upper + b * (lower - upper) - (gain * intensities[i] + bias)
        usable[i] = True
        count += 1
    return count


@compiled(fastmath={"contract"})
def _template(chosen, image, depth, lens, points, intensities, jacobian):
    """Fills points, (3, N), intensities, (N,), and jacobian, (N, 6); no pixel is at the border."""
    width = np.intp(image.shape[1])
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    three, ten, share = _F(3.0), _F(10.0), _F(1.0 / 32.0)
    for i in range(chosen.shape[0]):
        r, c = chosen[i] // width, chosen[i] % width
        left = three * (image[r - 1, c - 1] + image[r + 1, c - 1]) + ten * image[r, c - 1]
        right = three * (image[r - 1, c + 1] + image[r + 1, c + 1]) + ten * image[r, c + 1]
        above = three * (image[r - 1, c - 1] + image[r - 1, c + 1]) + ten * image[r - 1, c]
        below = three * (image[r + 1, c - 1] + image[r + 1, c + 1]) + ten * image[r + 1, c]
        z = depth[r, c]
        inverse = _F(1.0) / z
        x = (_F(c) + (_F(0.5) - cx)) / fx * z
        y = (_F(r) + (_F(0.5) - cy)) / fy * z
        by_x = (right - left) * share * fx * inverse
        by_y = (below - above) * share * fy * inverse
        by_z = -(by_x * x + by_y * y) * inverse
        points[0, i], points[1, i], points[2, i] = x, y, z
        intensities[i] = image[r, c]
        jacobian[i, 0], jacobian[i, 1], jacobian[i, 2] = by_x, by_y, by_z
        jacobian[i, 3] = by_z * y - by_y * z
        jacobian[i, 4] = by_x * z - by_z * x
        jacobian[i, 5] = by_y * x - by_x * y


@compiled()
def _thinned(indices, end, kept):
    """Fills kept; returns how many there are."""
    count = 0
    for index in indices:
        if (np.uint64(index) * np.uint64(2654435769)) & np.uint64(0xFFFFFFFF) < end:
            kept[count] = index
            count += 1
    return count


@compiled(fastmath={"contract", "reassoc", "nsz"})
def _normal_equations(
    jacobian, intensities, residuals, usable, gain, per_cutoff, hessian, right
):  # fmt: skip
    """Adds to the hessian, (8, 8), its upper half, and to the right side, (8,)."""
    design = np.empty((9, _BLOCK), dtype=np.float32)
    weighted = np.empty((8, _BLOCK), dtype=np.float32)
    count = intensities.shape[0]
    for begin in range(0, count, _BLOCK):
        size = min(_BLOCK, count - begin)
        for k in range(size):
            i = begin + k
            scaled = residuals[i] * per_cutoff
            kept = max(_F(1.0) - scaled * scaled, _F(0.0))
            weight = kept * kept if usable[i] else _F(0.0)
            for j in range(6):
                design[j, k] = gain * jacobian[i, j]
            design[6, k] = intensities[i]
            design[7, k] = _F(1.0)
            design[8, k] = residuals[i]
            for j in range(8):
                weighted[j, k] = weight * design[j, k]
        for j in range(8):
            for m in range(j, 9):
                total = _F(0.0)
                for k in range(size):
                    total += weighted[j, k] * design[m, k]
                if m < 8:
                    hessian[j, m] += total
                else:
                    right[j] += total


@compiled(fastmath={"contract", "reassoc", "nsz"})
def _inner_products(a, b, product):
    """Fills the product, (K, M); sums of many numbers are kept in double precision."""
    count = a.shape[1]
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            product[i, j] = 0.0
    for begin in range(0, count, _BLOCK):
        end = min(begin + _BLOCK, count)
        for i in range(a.shape[0]):
            for j in range(b.shape[0]):
                total = _F(0.0)
                for k in range(begin, end):
                    total += a[i, k] * b[j, k]
                product[i, j] += total


@compiled(fastmath={"contract", "reassoc", "nsz"})
def _weighted_squares(rows, weights, product):
    """Adds to the product's upper half, (K, K), which is zero."""
    count, several = weights.shape[0], rows.shape[0]
    weighted = np.empty((several, _BLOCK), dtype=np.float32)
    for begin in range(0, count, _BLOCK):
        size = min(_BLOCK, count - begin)
        for i in range(several):
            for k in range(size):
                weighted[i, k] = weights[begin + k] * rows[i, begin + k]
        for i in range(several):
            for j in range(i, several):
                total = _F(0.0)
                for k in range(size):
                    total += weighted[i, k] * rows[j, begin + k]
                product[i, j] += total


@compiled()
def _sums_by_label(labels, rows, sums):
    """Adds to the sums, (K, L), which are zero."""
    for i in range(rows.shape[0]):
        for k in range(labels.shape[0]):
            sums[i, labels[k]] += rows[i, k]


@compiled(fastmath={"contract"})
def _combined(matrix, rows, product):
    """Fills the product, (K, N)."""
    for i in range(matrix.shape[0]):
        for k in range(rows.shape[1]):
            product[i, k] = _F(0.0)
        for j in range(matrix.shape[1]):
            factor = matrix[i, j]
            for k in range(rows.shape[1]):
                product[i, k] += factor * rows[j, k]


@compiled(fastmath={"contract"})
def _vote(
    depth, lens, mask, view_lens, pose, nearest, farthest, known, tolerance, seen, votes
):  # fmt: skip
    """Adds to seen and votes, (H, W), within the mask."""
    height, width = known.shape
    fx, fy, cx, cy = view_lens[0], view_lens[1], view_lens[2], view_lens[3]
    for i in range(depth.shape[0]):
        ray_y = (i + 0.5 - lens[3]) / lens[1]
        for j in range(depth.shape[1]):
            if not mask[i, j]:
                continue
            z = np.float64(depth[i, j])
            x, y = (j + 0.5 - lens[2]) / lens[0] * z, ray_y * z
            ahead = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
            if not ahead > 1e-6:
                continue
            u = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / ahead * fx + cx
            v = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / ahead * fy + cy
            if not (u >= 0.0 and v >= 0.0 and u < width and v < height):
                continue
            column, row = np.intp(u), np.intp(v)
            if not known[row, column]:
                continue
            seen[i, j] += 1
            if nearest[row, column] - tolerance < ahead < farthest[row, column] + tolerance:
                votes[i, j] += 1


def inner_products(a: Float32Array, b: Float32Array) -> Float64Array:
    """As :func:`gscpe.refinement.products.inner_products`."""
    product = np.empty((len(a), len(b)))
    _inner_products(np.ascontiguousarray(a), np.ascontiguousarray(b), product)
    return product


def weighted_squares(rows: Float32Array, weights: Float32Array) -> Float64Array:
    """As :func:`gscpe.refinement.products.weighted_squares`."""
    product = np.zeros((len(rows), len(rows)))
    _weighted_squares(np.ascontiguousarray(rows), np.ascontiguousarray(weights), product)
    return product + np.triu(product, 1).T


def sums_by_label(labels: IntArray, rows: Float32Array, count: int) -> Float64Array:
    """As :func:`gscpe.refinement.products.sums_by_label`."""
    sums = np.zeros((len(rows), count))
    _sums_by_label(labels, np.ascontiguousarray(rows), sums)
    return sums


def combined(matrix: Float32Array, rows: Float32Array) -> Float32Array:
    """As :func:`gscpe.refinement.products.combined`."""
    product = np.empty((len(matrix), rows.shape[1]), dtype=np.float32)
    _combined(np.ascontiguousarray(matrix), np.ascontiguousarray(rows), product)
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
    """As :func:`gscpe.refinement.lucas_kanade.residuals_of`."""
    residuals = np.empty(len(intensities), dtype=np.float32)
    usable = np.empty(len(intensities), dtype=np.bool_)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32)
    _residuals(
        *(points, intensities, image, valid, photo_from_anchor[:3].astype(np.float32), lens),
        *(np.array([gain, bias], dtype=np.float32), residuals, usable),
    )
    return residuals, usable


def template_of(
    image: Float32Array, depth: Float32Array, camera: Camera, chosen: IntArray
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Points, (3, N), intensities, (N,), and Jacobian, (N, 6), of pixels of an anchor, as
    :class:`gscpe.refinement.lucas_kanade.Template` has them.

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
    _template(chosen, image, depth, lens, points, intensities, jacobian)
    return points, intensities, jacobian


def thinned(indices: IntArray, end: int) -> IntArray:
    """Those whose place in a Weyl sequence of 32 bits is before ``end``."""
    kept = np.empty_like(indices)
    return kept[: _thinned(indices, np.uint64(end), kept)].copy()


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
    _normal_equations(
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
    _vote(
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
