"""Global descriptors: of unit length, repeatable, and nearest to their own place."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera

from gscpe.errors import MapError
from gscpe.geometry import se3
from gscpe.mapping.from_splat import describe_references
from gscpe.retrieval import (
    VladSettings,
    describe_image,
    learn_vocabulary,
    local_descriptors,
    search,
)

CAMERA = room_camera(160, 120)
SETTINGS = VladSettings(words=16)
STEPS = [
    np.zeros(6),
    np.array([0.0, 0.0, 0.0, 0.0, 0.5, 0.0]),
    np.array([0.3, 0.0, 0.0, 0.0, -0.4, 0.0]),
    np.array([-0.5, 0.2, 0.3, 0.2, 0.0, 0.0]),
]


def photo(step: NDArray[np.float64]) -> NDArray[np.uint8]:
    return room().shoot(CAMERA, se3.exp(step) @ ROOM_POSE).uint8


@pytest.fixture(scope="module")
def local() -> list[NDArray[np.float32]]:
    """Local descriptors of four photos of different parts of the room."""
    return [local_descriptors(photo(step), SETTINGS) for step in STEPS]


@pytest.fixture(scope="module")
def vocabulary(local: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    return learn_vocabulary(local, SETTINGS)


def test_unit_length(local: list[NDArray[np.float32]], vocabulary: NDArray[np.float32]) -> None:
    for each in local:
        vlad = describe_image(each, vocabulary)
        assert vlad.shape == (16 * 128,)
        assert vlad.dtype == np.float32
        assert np.linalg.norm(vlad) == pytest.approx(1.0, abs=1e-5)


def test_a_photo_finds_itself(
    local: list[NDArray[np.float32]], vocabulary: NDArray[np.float32]
) -> None:
    descriptors = np.stack([describe_image(each, vocabulary) for each in local])
    for index, each in enumerate(local):
        found = search(describe_image(each, vocabulary), descriptors, 4)
        assert found[0].index == index
        assert found[0].similarity == pytest.approx(1.0, abs=1e-5)
        assert sorted(reference.index for reference in found) == [0, 1, 2, 3]
        similarities = [reference.similarity for reference in found]
        assert similarities == sorted(similarities, reverse=True)


def test_a_photo_from_nearby_finds_its_place(
    local: list[NDArray[np.float32]], vocabulary: NDArray[np.float32]
) -> None:
    descriptors = np.stack([describe_image(each, vocabulary) for each in local])
    nearby = np.array([0.03, -0.02, 0.03, 0.01, -0.02, 0.02])
    for index, step in enumerate(STEPS):
        query = local_descriptors(photo(nearby + step), SETTINGS)
        assert search(describe_image(query, vocabulary), descriptors, 1)[0].index == index


def test_repeatable(local: list[NDArray[np.float32]], vocabulary: NDArray[np.float32]) -> None:
    np.testing.assert_array_equal(learn_vocabulary(local, SETTINGS), vocabulary)
    assert not np.array_equal(learn_vocabulary(local, SETTINGS, seed=1), vocabulary)
    np.testing.assert_array_equal(local_descriptors(photo(STEPS[0]), SETTINGS), local[0])


def test_blank_photos_are_all_zero(vocabulary: NDArray[np.float32]) -> None:
    blank = local_descriptors(np.full((120, 160, 3), 80, np.uint8), SETTINGS)
    assert blank.shape == (0, 128)
    np.testing.assert_array_equal(describe_image(blank, vocabulary), np.zeros(16 * 128))


@pytest.mark.parametrize(
    ("count", "words"), [(0, 1), (1, 1), (7, 1), (16, 2), (39, 4), (127, 15), (128, 16), (900, 16)]
)
def test_the_vocabulary_shrinks_with_few_descriptors(
    count: int, words: int, rng: np.random.Generator
) -> None:
    few = np.abs(rng.normal(size=(count, 128))).astype(np.float32)
    vocabulary = learn_vocabulary([few], SETTINGS)
    assert vocabulary.shape == (words, 128)
    assert vocabulary.dtype == np.float32
    assert np.isfinite(vocabulary).all()


def test_training_is_bounded(local: list[NDArray[np.float32]]) -> None:
    bounded = VladSettings(words=16, training_descriptors=64)
    assert learn_vocabulary(local, bounded).shape == (8, 128)


def test_large_photos_are_shrunk_first() -> None:
    large = room().shoot(room_camera(640, 480), ROOM_POSE).uint8
    shrunk = local_descriptors(large, VladSettings(longest_side=160))
    assert 0.5 < len(shrunk) / len(local_descriptors(photo(STEPS[0]), SETTINGS)) < 2.0
    thin = np.zeros((2, 4000, 3), np.uint8)
    assert len(local_descriptors(thin, SETTINGS)) == 0


@given(st.integers(1, 12), st.integers(1, 20))
def test_search_returns_at_most_all(references: int, count: int) -> None:
    rng = np.random.default_rng(references)
    descriptors = rng.normal(size=(references, 6)).astype(np.float32)
    found = search(descriptors[0], descriptors, count)
    assert len(found) == min(references, count)
    expected = np.sort(descriptors @ descriptors[0])[::-1][:count]
    np.testing.assert_allclose([reference.similarity for reference in found], expected, rtol=1e-5)


def test_maps_need_photos_but_not_features() -> None:
    with pytest.raises(MapError, match="at least one reference photo"):
        describe_references([], SETTINGS)
    blank = np.zeros((60, 80, 3), np.uint8)
    known = describe_references([blank, blank], SETTINGS)
    assert known.descriptors.shape == (2, 128)
    assert not known.descriptors.any()
