# SPDX-License-Identifier: Apache-2.0
"""The search of references: exact for few, by an index for many."""

from __future__ import annotations

import importlib.util
import logging
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gscpe.errors import SettingsError
from gscpe.retrieval import IndexSettings, ReferenceIndex, search

needs_faiss = pytest.mark.skipif(
    importlib.util.find_spec("faiss") is None, reason="faiss is an optional package (extra: index)"
)


def unit(rng: np.random.Generator, count: int, dimension: int) -> np.ndarray:
    rows = rng.normal(size=(count, dimension))
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), dtype=np.float32)


@given(st.integers(1, 12), st.integers(1, 20))
def test_search_returns_the_best(references: int, count: int) -> None:
    rng = np.random.default_rng(references)
    descriptors = rng.normal(size=(references, 6)).astype(np.float32)
    found = search(descriptors[0], descriptors, count)
    assert len(found) == min(references, count)
    expected = np.sort(descriptors @ descriptors[0])[::-1][:count]
    np.testing.assert_allclose([reference.similarity for reference in found], expected, rtol=1e-5)


def test_of_equal_ones_the_first() -> None:
    rows = np.array([[0, 1], [1, 0], [1, 0], [0, 1], [1, 0]], dtype=np.float32)
    assert [each.index for each in search(rows[1], rows, 2)] == [1, 2]
    assert [each.index for each in search(rows[1], rows, 4)] == [1, 2, 4, 0]


@needs_faiss
@pytest.mark.parametrize("dimension", [8, 96])
def test_an_index_that_looks_everywhere_is_exact(dimension: int, rng: np.random.Generator) -> None:
    descriptors = unit(rng, 2000, dimension)
    index = ReferenceIndex(descriptors, IndexSettings(0, exact_queries=0, lists=40, probes=40))
    assert index._index is not None
    for query in [*unit(rng, 30, dimension), *descriptors[:30]]:
        found, expected = index.search(query, 3), search(query, descriptors, 3)
        assert [each.index for each in found] == [each.index for each in expected]
        np.testing.assert_allclose(
            [each.similarity for each in found],
            [each.similarity for each in expected],
            atol=1e-6,
        )


@needs_faiss
def test_fewer_probes_find_places_all_the_same(
    rng: np.random.Generator, capfd: pytest.CaptureFixture[str]
) -> None:
    descriptors = unit(rng, 3000, 64)
    index = ReferenceIndex(descriptors, IndexSettings(2999, exact_queries=0, probes=16))
    queries = descriptors + 0.3 / 8 * rng.normal(size=descriptors.shape).astype(np.float32)
    right = [index.search(query, 1)[0].index == i for i, query in enumerate(queries[:300])]
    assert np.mean(right) > 0.9
    assert capfd.readouterr() == ("", "")


@needs_faiss
def test_tiny_indices(rng: np.random.Generator) -> None:
    descriptors = unit(rng, 3, 16)
    index = ReferenceIndex(descriptors, IndexSettings(0, exact_queries=0))
    assert index.search(descriptors[2], 5)[0].index == 2
    assert 1 <= len(index.search(descriptors[2], 5)) <= 3


@needs_faiss
def test_the_index_is_built_once_it_pays(rng: np.random.Generator) -> None:
    descriptors = unit(rng, 50, 16)
    index = ReferenceIndex(descriptors, IndexSettings(49, exact_queries=2, lists=4, probes=4))
    few = ReferenceIndex(descriptors, IndexSettings(50, exact_queries=2))
    for built in (False, True, True):
        assert index.search(descriptors[7], 1)[0].index == 7
        assert (index._index is not None) == built
        few.search(descriptors[7], 1)
        assert few._index is None


def test_without_faiss_the_remedy_is_logged(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    descriptors = unit(rng, 20, 8)
    with caplog.at_level(logging.WARNING):
        few = ReferenceIndex(descriptors)
        assert caplog.text == ""
        many = ReferenceIndex(descriptors, IndexSettings(exact_up_to=19))
    assert "pip install 'gscpe[index]'" in caplog.text
    assert many.search(descriptors[4], 2) == few.search(descriptors[4], 2)


@pytest.mark.parametrize(
    "wrong", [{"exact_up_to": -1}, {"exact_queries": -1}, {"probes": 0}, {"lists": 0}]
)
def test_impossible_settings(wrong: dict[str, int]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        IndexSettings(**wrong)


@needs_faiss
def test_threads_may_search_while_the_index_is_built(rng: np.random.Generator) -> None:
    """It is built once, in the middle; before and after, the answers are the same."""
    descriptors = unit(rng, 2000, 32)
    index = ReferenceIndex(descriptors, IndexSettings(0, exact_queries=20, lists=20, probes=20))
    queries = unit(rng, 80, 32)
    with ThreadPoolExecutor(8) as pool:
        for query, found in zip(
            queries, pool.map(lambda query: index.search(query, 3), queries), strict=True
        ):
            expected = search(query, descriptors, 3)
            assert [each.index for each in found] == [each.index for each in expected]
    assert index._index is not None
