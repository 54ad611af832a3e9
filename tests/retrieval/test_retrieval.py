# SPDX-License-Identifier: Apache-2.0
"""VLAD: of unit length, repeatable, independent of order, and nearest to its own place."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera

from gscpe.errors import MapError, SettingsError
from gscpe.geometry import se3
from gscpe.photos import Photo, to_photo
from gscpe.retrieval import (
    VocabularySettings,
    aggregate,
    describe_references,
    learn_vocabulary,
    open_describer,
    rootsift,
    search,
)

CAMERA = room_camera(160, 120)
SETTINGS = VocabularySettings(words=16)
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
    return [rootsift(photo(step)) for step in STEPS]


@pytest.fixture(scope="module")
def vocabulary(local: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    return learn_vocabulary(local, SETTINGS)


def test_unit_length(local: list[NDArray[np.float32]], vocabulary: NDArray[np.float32]) -> None:
    for each in local:
        vlad = aggregate(each, vocabulary)
        assert vlad.shape == (16 * 128,)
        assert vlad.dtype == np.float32
        assert np.linalg.norm(vlad) == pytest.approx(1.0, abs=1e-5)


@given(st.integers(0, 40), st.integers(1, 9), st.integers(1, 7), st.randoms())
def test_vlad_by_its_definition_in_any_order(
    count: int, words: int, width: int, random: Random
) -> None:
    rng = np.random.default_rng(random.randrange(2**32))
    descriptors = rng.normal(size=(count, width)).astype(np.float32)
    vocabulary = rng.normal(size=(words, width)).astype(np.float32)
    expected = np.zeros((words, width))
    for each in descriptors:
        word = np.argmin(((vocabulary - each) ** 2).sum(axis=1))
        expected[word] += each - vocabulary[word]
    expected = np.sign(expected) * np.abs(expected) ** 0.5
    expected /= max(float(np.linalg.norm(expected)), 1e-12)
    vlad = aggregate(descriptors, vocabulary)
    np.testing.assert_allclose(vlad, expected.ravel(), atol=1e-3)
    np.testing.assert_allclose(aggregate(rng.permutation(descriptors), vocabulary), vlad, atol=1e-3)
    assert np.linalg.norm(vlad) == pytest.approx(1.0 if count else 0.0, abs=1e-5)


def test_a_photo_finds_itself(
    local: list[NDArray[np.float32]], vocabulary: NDArray[np.float32]
) -> None:
    descriptors = np.stack([aggregate(each, vocabulary) for each in local])
    for index, each in enumerate(local):
        found = search(aggregate(each, vocabulary), descriptors, 4)
        assert found[0].index == index
        assert found[0].similarity == pytest.approx(1.0, abs=1e-5)
        assert sorted(reference.index for reference in found) == [0, 1, 2, 3]
        similarities = [reference.similarity for reference in found]
        assert similarities == sorted(similarities, reverse=True)


def test_a_photo_from_nearby_finds_its_place(
    local: list[NDArray[np.float32]], vocabulary: NDArray[np.float32]
) -> None:
    descriptors = np.stack([aggregate(each, vocabulary) for each in local])
    nearby = np.array([0.03, -0.02, 0.03, 0.01, -0.02, 0.02])
    for index, step in enumerate(STEPS):
        query = rootsift(photo(nearby + step))
        assert search(aggregate(query, vocabulary), descriptors, 1)[0].index == index


def test_repeatable(local: list[NDArray[np.float32]], vocabulary: NDArray[np.float32]) -> None:
    np.testing.assert_array_equal(learn_vocabulary(local, SETTINGS), vocabulary)
    assert not np.array_equal(learn_vocabulary(local, SETTINGS, seed=1), vocabulary)
    np.testing.assert_array_equal(rootsift(photo(STEPS[0])), local[0])


def test_blank_photos_are_all_zero(vocabulary: NDArray[np.float32]) -> None:
    blank = rootsift(np.full((120, 160, 3), 80, np.uint8))
    assert blank.shape == (0, 128)
    np.testing.assert_array_equal(aggregate(blank, vocabulary), np.zeros(16 * 128))


@pytest.mark.parametrize(
    ("count", "words"), [(0, 1), (1, 1), (7, 1), (16, 2), (39, 4), (127, 15), (128, 16), (900, 16)]
)
@pytest.mark.parametrize("width", [64, 128])
def test_the_vocabulary_shrinks_with_few_descriptors(
    count: int, words: int, width: int, rng: np.random.Generator
) -> None:
    few = np.abs(rng.normal(size=(count, width))).astype(np.float32)
    vocabulary = learn_vocabulary([few], SETTINGS)
    assert vocabulary.shape == (words, width)
    assert vocabulary.dtype == np.float32
    assert np.isfinite(vocabulary).all()


def test_words_of_few_different_descriptors() -> None:
    """As many as there are different ones, each where they are."""
    different = np.eye(3, 128, dtype=np.float32)
    vocabulary = learn_vocabulary([np.repeat(different, 100, axis=0)], SETTINGS)
    assert vocabulary.shape == (3, 128)
    np.testing.assert_allclose(
        vocabulary[vocabulary.argmax(axis=1).argsort()], different, atol=1e-6
    )


def test_training_is_bounded(local: list[NDArray[np.float32]]) -> None:
    bounded = VocabularySettings(words=16, training_descriptors=64)
    assert learn_vocabulary(local, bounded).shape == (8, 128)
    for wrong in ({"words": 0}, {"training_descriptors": 0}):
        with pytest.raises(SettingsError, match="must be a whole number"):
            VocabularySettings(**wrong)


def test_large_photos_are_shrunk_first() -> None:
    """A photo of 640 x 480 gives as many features as one of 320 x 240, not four times."""
    large, small = (
        room().shoot(room_camera(*size), ROOM_POSE).uint8 for size in ((640, 480), (320, 240))
    )
    assert 0.7 < len(rootsift(large)) / len(rootsift(small)) < 1.4
    assert len(rootsift(np.zeros((2, 4000, 3), np.uint8))) == 0


def test_queries_are_described_as_references() -> None:
    photos = [to_photo(photo(step), CAMERA) for step in STEPS]
    known = describe_references(photos)
    describer = open_describer(known)
    assert known.method == "vlad"
    assert known.descriptors.shape == (4, known.vocabulary.size)
    for each, expected in zip(photos, known.descriptors, strict=True):
        np.testing.assert_array_equal(describer.describe(each.rgb), expected)


def test_maps_need_photos_but_not_features() -> None:
    with pytest.raises(MapError, match="at least one reference photo"):
        describe_references([])
    blank = Photo(np.zeros((60, 80, 3), np.uint8), room_camera(80, 60))
    known = describe_references([blank, blank])
    assert known.descriptors.shape == (2, 128)
    assert not known.descriptors.any()


def test_many_photos_are_described_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """More than words are learned from."""
    monkeypatch.setattr("gscpe.retrieval.methods._TRAINING_PHOTOS", 2)
    photos = [to_photo(photo(step), CAMERA) for step in STEPS]
    known = describe_references(photos)
    expected = [rootsift(each.rgb) for each in photos]
    learned = VocabularySettings(words=64)
    np.testing.assert_array_equal(
        known.vocabulary, learn_vocabulary([expected[0], expected[3]], learned)
    )
    for row, each in zip(known.descriptors, expected, strict=True):
        np.testing.assert_array_equal(row, aggregate(each, known.vocabulary))
