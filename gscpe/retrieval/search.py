"""Nearest reference photos by global descriptor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscpe.arrays import Float32Array


@dataclass(frozen=True)
class RetrievedReference:
    """Index of a reference photo, and its cosine similarity to the query in [-1, 1]."""

    index: int
    similarity: float


def search(
    query: Float32Array, descriptors: Float32Array, count: int
) -> tuple[RetrievedReference, ...]:
    """The ``count`` most similar rows of ``descriptors``, (N, D), to ``query``, (D,)."""
    similarities = descriptors @ query
    best = np.argsort(-similarities, kind="stable")[:count]
    return tuple(RetrievedReference(int(i), float(similarities[i])) for i in best)
