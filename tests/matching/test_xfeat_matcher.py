# SPDX-License-Identifier: Apache-2.0
"""The XFeat matchers with features that are made up, and the real networks where installed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera

from gscpe.errors import SettingsError
from gscpe.features.xfeat import XFeat, XFeatFeatures
from gscpe.matching import (
    LighterGlueMatcher,
    LighterGlueMatcherSettings,
    Matcher,
    PolishSettings,
    SiftMatcher,
    SiftMatcherSettings,
    XFeatMatcher,
    XFeatMatcherSettings,
)
from gscpe.matching.lighterglue import LighterGlue
from gscpe.matching.nearest import mutual_nearest
from gscpe.models import installed_files

UNPOLISHED = XFeatMatcherSettings(polish=None)
BLANK = np.full((40, 60, 3), 80, np.uint8)


class FakeXFeat:
    """Gives prepared features, one set a call, and remembers what it was asked."""

    def __init__(self, *answers: XFeatFeatures) -> None:
        self.answers = list(answers)
        self.asked: list[tuple[int, Any]] = []

    def detect(self, image: Any, max_features: int, *, valid: Any = None) -> XFeatFeatures:
        self.asked.append((max_features, valid))
        return self.answers.pop(0)


class FakeLighterGlue:
    """Matches features by their order, and remembers what it was asked."""

    def match(self, a: Any, size_a: Any, b: Any, size_b: Any, **settings: float) -> Any:
        self.sizes, self.settings = (size_a, size_b), settings
        pairs = np.array([[0, 2], [3, 1]])
        return pairs, np.array([0.9, 0.5], dtype=np.float32)


def features(descriptors: Any, keypoints: Any = None) -> XFeatFeatures:
    unit = np.asarray(descriptors, dtype=np.float32)
    unit = unit / np.maximum(np.linalg.norm(unit, axis=-1, keepdims=True), 1e-12)
    count = len(unit)
    if keypoints is None:
        keypoints = np.arange(2 * count).reshape(count, 2) + 0.5
    return XFeatFeatures(
        np.asarray(keypoints, np.float64), np.linspace(1, 0.5, count, dtype=np.float32), unit
    )


def match(
    a: XFeatFeatures, b: XFeatFeatures, settings: XFeatMatcherSettings = UNPOLISHED
) -> list[tuple[float, float]]:
    """Abscissae of what was matched."""
    matcher = XFeatMatcher(settings, cast(XFeat, FakeXFeat(a, b)))
    matches = matcher.match(matcher.prepare(BLANK, None), matcher.prepare(BLANK, None))
    assert matches.photo_pixels.shape == matches.render_pixels.shape == (len(matches), 2)
    assert matches.scores.dtype == np.float32
    return list(zip(matches.photo_pixels[:, 0], matches.render_pixels[:, 0], strict=True))


def test_only_mutual_neighbours_match() -> None:
    """The third of the photo likes the first of the render, which likes another more."""
    a = features([[1, 0, 0], [0, 1, 0], [1, 0.3, 0]])
    b = features([[1, 0.02, 0], [0, 0.1, 1], [0, 1, 0.1]])
    assert match(a, b) == [(0.5, 0.5), (2.5, 4.5)]


def test_the_least_similarity() -> None:
    angle = np.arccos(0.82)
    for extra, expected in ((-0.01, 1), (0.01, 0)):
        turned = [[np.cos(angle + extra), np.sin(angle + extra)]]
        assert len(match(features([[1, 0]]), features(turned))) == expected
    strict = XFeatMatcherSettings(min_cosine=0.9, polish=None)
    assert not match(features([[1, 0]]), features([[0.85, np.sqrt(1 - 0.85**2)]]), strict)


def test_without_features_there_are_no_matches() -> None:
    none, some = features(np.zeros((0, 64))), features(np.eye(64)[:3])
    for a, b in ((none, some), (some, none), (none, none)):
        assert match(a, b) == match(a, b, XFeatMatcherSettings()) == []


def test_what_the_network_is_asked() -> None:
    fake = FakeXFeat(features(np.eye(3)), features(np.eye(3)))
    matcher = XFeatMatcher(XFeatMatcherSettings(max_features=77), cast(XFeat, fake))
    valid = np.ones((40, 60), dtype=bool)
    assert matcher.prepare(BLANK, valid).size == (60, 40)
    matcher.prepare(BLANK, None)
    assert fake.asked[0][0] == fake.asked[1][0] == 77
    assert fake.asked[0][1] is valid
    assert fake.asked[1][1] is None
    assert XFeatMatcherSettings().max_features == 4096


def of_kind(kind: str, polish: PolishSettings | None, corners: NDArray[np.float64]) -> Matcher:
    """A matcher that finds features at these pixels of both images; SIFT finds its own."""
    fake = cast(XFeat, FakeXFeat(*[features(np.eye(4), corners)] * 2))
    if kind == "xfeat":
        return XFeatMatcher(XFeatMatcherSettings(polish=polish), fake)
    if kind == "lighterglue":
        settings = LighterGlueMatcherSettings(polish=polish)
        return LighterGlueMatcher(settings, fake, cast(LighterGlue, InOrder()))
    return SiftMatcher(SiftMatcherSettings(polish=polish))


@pytest.mark.parametrize("kind", ["xfeat", "lighterglue", "sift"])
def test_matches_are_polished_as_the_settings_say(kind: str) -> None:
    """The room seen by a camera with another principal point: all moves by the same."""
    camera = room_camera(240, 180)
    images = [room().shoot(camera, ROOM_POSE).uint8]
    moved = replace(camera, cx=camera.cx + 0.4, cy=camera.cy - 0.3)
    images.append(room().shoot(moved, ROOM_POSE).uint8)
    corners = np.array([[60.5, 50.5], [100.5, 90.5], [150.5, 120.5], [180.5, 70.5]])

    def shift(polish: PolishSettings | None) -> NDArray[np.float64]:
        matcher = of_kind(kind, polish, corners)
        photo, render = (matcher.prepare(image, None) for image in images)
        matches = matcher.match(photo, render)
        return np.asarray(np.median(matches.render_pixels - matches.photo_pixels, axis=0))

    np.testing.assert_allclose(shift(PolishSettings()), [0.4, -0.3], atol=0.06)
    if kind != "sift":
        np.testing.assert_array_equal(shift(None), [0, 0])


class InOrder:
    def match(self, a: XFeatFeatures, *_: Any, **__: Any) -> Any:
        return np.repeat(np.arange(len(a))[:, None], 2, axis=1), a.scores


def test_lighterglue_is_asked_rightly_and_its_pairs_are_taken() -> None:
    fake = FakeXFeat(features(np.eye(4)), features(np.eye(4)))
    network = FakeLighterGlue()
    settings = LighterGlueMatcherSettings(max_features=9, min_score=0.3, polish=None)
    matcher = LighterGlueMatcher(settings, cast(XFeat, fake), cast(LighterGlue, network))
    photo, render = matcher.prepare(BLANK, None), matcher.prepare(BLANK[:30], None)
    matches = matcher.match(photo, render)
    np.testing.assert_array_equal(matches.photo_pixels, [[0.5, 1.5], [6.5, 7.5]])
    np.testing.assert_array_equal(matches.render_pixels, [[4.5, 5.5], [2.5, 3.5]])
    np.testing.assert_allclose(matches.scores, [0.9, 0.5])
    assert network.sizes == ((60, 40), (60, 30))
    assert network.settings == {"min_score": 0.3, "max_features": 9}
    assert [count for count, _ in fake.asked] == [9, 9]


def test_mutual_nearest_neighbours(rng: np.random.Generator) -> None:
    """Against the definition, and one-to-one where entries are equal."""
    similarity = rng.normal(size=(37, 53)).astype(np.float32)
    expected = [
        (row, column)
        for row in range(37)
        for column in range(53)
        if similarity[row, column] == similarity[row].max() == similarity[:, column].max()
    ]
    assert list(zip(*mutual_nearest(similarity), strict=True)) == expected
    rows, columns = mutual_nearest(np.ones((4, 3), dtype=np.float32))
    assert (rows.tolist(), columns.tolist()) == ([0], [0])


@pytest.mark.parametrize("wrong", [{"max_features": 0}, {"min_cosine": 1.0}, {"min_cosine": -2.0}])
def test_impossible_xfeat_settings(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        XFeatMatcherSettings(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [{"max_features": 0}, {"min_score": 1.0}, {"min_score": -0.1}])
def test_impossible_lighterglue_settings(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        LighterGlueMatcherSettings(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", [XFeatMatcher, LighterGlueMatcher])
def test_the_real_networks_on_a_moved_camera(kind: type[XFeatMatcher]) -> None:
    """Features of a photo and of a picture with the principal point moved differ by that."""
    if any(file.state != "ok" for file in installed_files("xfeat")):
        pytest.skip("XFeat is not installed (gscpe models install xfeat)")
    camera = room_camera(240, 180)
    moved = replace(camera, cx=camera.cx + 6.3, cy=camera.cy - 2.6)
    matcher = kind()
    photo = matcher.prepare(room().shoot(camera, ROOM_POSE).uint8, None)
    render = matcher.prepare(room().shoot(moved, ROOM_POSE).uint8, None)
    matches = matcher.match(photo, render)
    errors = matches.render_pixels - matches.photo_pixels - (6.3, -2.6)
    assert len(matches) > 100
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.05
    np.testing.assert_allclose(np.median(errors, axis=0), [0, 0], atol=0.02)
