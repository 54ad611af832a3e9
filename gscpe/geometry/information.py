# SPDX-License-Identifier: Apache-2.0
"""Covariances: what is one, and those of information matrices that may be singular."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from gscpe.arrays import Float64Array

_LEAST = 1e-9


def covariance_from_information(information: Float64Array) -> Float64Array:
    """The inverse of a symmetric positive semi-definite matrix, (N, N).

    A direction that the information does not determine gets a variance that is large beside
    all others, where a pseudo-inverse would claim that it is known exactly.
    """
    diagonal = np.sqrt(np.maximum(np.diag(information), 0.0))
    # Rows of other units are made comparable; one without any information stays tiny.
    scale = np.maximum(diagonal, 1e-6 * max(float(diagonal.max(initial=0.0)), 1e-12))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    values = np.maximum(values, _LEAST * max(float(values.max(initial=0.0)), 1e-12))
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


def is_covariance(rows: Sequence[Sequence[float]], size: int) -> bool:
    """Whether these are (size, size) finite numbers, symmetric and positive semi-definite."""
    try:
        matrix = np.array(rows, dtype=np.float64)
    except (ValueError, TypeError):
        return False
    if matrix.shape != (size, size) or not np.all(np.isfinite(matrix)):
        return False
    smallest = 1e-9 * float(np.abs(matrix).max())
    return bool(
        np.all(np.abs(matrix - matrix.T) <= smallest) and np.linalg.eigvalsh(matrix)[0] >= -smallest
    )
