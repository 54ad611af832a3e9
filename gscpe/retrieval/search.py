# SPDX-License-Identifier: Apache-2.0
"""Nearest reference photos by global descriptor.

Up to 100 000 references, one matrix product answers exactly. Beyond, an inverted file of faiss
(optional) narrows the candidates down first. Building it takes as long as a few hundred exact
searches, so it is put off until there were as many. It is not stored in the map: reading
faiss's own format from a file that somebody else made is not memory-safe.
"""

from __future__ import annotations

import importlib.util
import logging
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from gscpe.arrays import Float32Array, IntArray
from gscpe.ranges import check_whole

_log = logging.getLogger(__name__)

_SPARE = 4
"""Times as many candidates as asked for are compared exactly: the index rounds."""


@dataclass(frozen=True)
class RetrievedReference:
    """Index of a reference photo, and its cosine similarity to the query in [-1, 1]."""

    index: int
    similarity: float


@dataclass(frozen=True)
class IndexSettings:
    """How references are searched.

    Attributes:
        exact_up_to: up to this many references, the query is compared with all of them.
        exact_queries: the index is built after this many searches; 0: at once.
        lists: into how many lists the index sorts the others; None: by their number.
        probes: number of lists that are searched; with all of them, the search is exact.
    """

    exact_up_to: int = 100_000
    exact_queries: int = 300
    lists: int | None = None
    probes: int = 32

    def __post_init__(self) -> None:
        check_whole(self, "probes", least=1)
        check_whole(self, "lists", least=1, optional=True)
        check_whole(self, "exact_up_to", "exact_queries", least=0)


class ReferenceIndex:
    """Searches descriptors, (N, D) float32; from any thread."""

    def __init__(self, descriptors: Float32Array, settings: IndexSettings | None = None) -> None:
        self._descriptors = descriptors
        self._index: Any = None
        self._settings = settings or IndexSettings()
        self._queries = 0
        self._lock = threading.Lock()
        self._wanted = len(descriptors) > self._settings.exact_up_to
        if self._wanted and importlib.util.find_spec("faiss") is None:
            _log.warning(
                "%d references are compared one by one, which is slow; "
                "pip install 'gscpe[index]' for an index",
                len(descriptors),
            )
            self._wanted = False
        self._build_when_due()

    def search(self, query: Float32Array, count: int) -> tuple[RetrievedReference, ...]:
        """The ``count`` most similar references to ``query``, (D,), best first."""
        index = self._index
        if index is None:
            found = search(query, self._descriptors, count)
            with self._lock:
                self._queries += 1
                self._build_when_due()
            return found
        wanted = min(_SPARE * count, len(self._descriptors))
        _, rows = index.search(np.ascontiguousarray(query[None]), wanted)
        candidates = np.sort(rows[0][rows[0] >= 0])  # -1 stands where lists were too short
        return _best(self._descriptors[candidates] @ query, candidates, count)

    def _build_when_due(self) -> None:
        if self._index is None and self._wanted and self._queries >= self._settings.exact_queries:
            _log.info("building an index of %d references", len(self._descriptors))
            self._index = _build(self._descriptors, self._settings)


def search(
    query: Float32Array, descriptors: Float32Array, count: int
) -> tuple[RetrievedReference, ...]:
    """The ``count`` most similar rows of ``descriptors``, (N, D), to ``query``, (D,)."""
    return _best(descriptors @ query, np.arange(len(descriptors)), count)


def _best(
    similarities: Float32Array, indices: IntArray, count: int
) -> tuple[RetrievedReference, ...]:
    """Best first; of equal ones, the one with the smaller index."""
    kept = np.arange(len(similarities))
    if len(kept) > count:
        least = np.partition(similarities, len(kept) - count)[len(kept) - count]
        kept = np.flatnonzero(similarities >= least)
    order = kept[np.argsort(-similarities[kept], kind="stable")][:count]
    return tuple(RetrievedReference(int(indices[i]), float(similarities[i])) for i in order)


def _build(descriptors: Float32Array, settings: IndexSettings) -> Any:
    """An inverted file, its vectors in half precision."""
    import faiss

    count, dimension = descriptors.shape
    lists = settings.lists or int(np.clip(2 * np.sqrt(count), 1, 4096))
    lists = min(lists, count)
    index = faiss.IndexIVFScalarQuantizer(
        faiss.IndexFlatIP(dimension),
        dimension,
        lists,
        faiss.ScalarQuantizer.QT_fp16,
        faiss.METRIC_INNER_PRODUCT,
    )
    index.cp.niter = 8
    index.cp.min_points_per_centroid = 1  # it would warn on stdout
    step = max(1, count // (_TRAINING * lists))
    index.train(np.ascontiguousarray(descriptors[::step], dtype=np.float32))
    index.add(np.ascontiguousarray(descriptors, dtype=np.float32))
    index.nprobe = min(settings.probes, lists)
    return index


_TRAINING = 40
"""Descriptors a list that the lists are learned from."""
