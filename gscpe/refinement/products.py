# SPDX-License-Identifier: Apache-2.0
"""Products of a few long rows, without the threads of a linear algebra library.

OpenBLAS shares even small products among threads that wait for each other in a loop. While
another thread of ours renders, such a product takes a hundred times as long. So Numba's loops
are used where they are installed.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from gscpe.arrays import Float32Array, Float64Array, IntArray


@functools.cache
def compiled_loops() -> Any:
    """The module of that name, compiled; None where Numba is not installed."""
    try:
        from gscpe.refinement import compiled_loops as loops
    except ImportError:
        return None
    loops.compile_now()
    return loops


def inner_products(a: Float32Array, b: Float32Array) -> Float64Array:
    """``a b^T``, (K, M), of (K, N) and (M, N)."""
    loops = compiled_loops()
    product = a @ b.T if loops is None else loops.inner_products(a, b)
    return np.asarray(product, dtype=np.float64)


def weighted_squares(rows: Float32Array, weights: Float32Array) -> Float64Array:
    """``rows diag(weights) rows^T``, (K, K), of (K, N) and (N,)."""
    loops = compiled_loops()
    if loops is None:
        return np.asarray((rows * weights) @ rows.T, dtype=np.float64)
    return np.asarray(loops.weighted_squares(rows, weights))


def sums_by_label(labels: IntArray, rows: Float32Array) -> Float64Array:
    """The sums of each row, (K, N), over what has the same label, (N,): (K, largest label + 1)."""
    count = int(labels.max(initial=0)) + 1
    loops = compiled_loops()
    if loops is None:
        return np.stack([np.bincount(labels, row, minlength=count) for row in rows])
    return np.asarray(loops.sums_by_label(labels, rows, count))


def combined(matrix: Float32Array, rows: Float32Array) -> Float32Array:
    """``matrix rows``, (K, N), of (K, M) and (M, N)."""
    loops = compiled_loops()
    product = matrix @ rows if loops is None else loops.combined(matrix, rows)
    return np.asarray(product, dtype=np.float32)
