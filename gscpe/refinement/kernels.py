# SPDX-License-Identifier: Apache-2.0
"""The refinement's loops over pixels, for Numba. What they are given and fill is made in
``compiled_loops.py``, which is typed; these are not: Numba finds their types by itself."""

from __future__ import annotations

import numpy as np

from gscpe.render.compiled import compiled

_F = np.float32
_BLOCK = 128
_NEAREST = _F(1e-3)


@compiled(fastmath={"contract"})
def residuals(points, intensities, image, valid, pose, camera, light, residuals, usable):
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
def template(chosen, image, depth, lens, points, intensities, jacobian):
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
def thinned(indices, end, kept):
    """Fills kept; returns how many there are."""
    count = 0
    for index in indices:
        if (np.uint64(index) * np.uint64(2654435769)) & np.uint64(0xFFFFFFFF) < end:
            kept[count] = index
            count += 1
    return count


@compiled(fastmath={"contract", "reassoc", "nsz"})
def normal_equations(
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
def inner_products(a, b, product):
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
def weighted_squares(rows, weights, product):
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
def sums_by_label(labels, rows, sums):
    """Adds to the sums, (K, L), which are zero."""
    for i in range(rows.shape[0]):
        for k in range(labels.shape[0]):
            sums[i, labels[k]] += rows[i, k]


@compiled(fastmath={"contract"})
def combined(matrix, rows, product):
    """Fills the product, (K, N)."""
    for i in range(matrix.shape[0]):
        for k in range(rows.shape[1]):
            product[i, k] = _F(0.0)
        for j in range(matrix.shape[1]):
            factor = matrix[i, j]
            for k in range(rows.shape[1]):
                product[i, k] += factor * rows[j, k]


@compiled(fastmath={"contract"})
def vote(
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
