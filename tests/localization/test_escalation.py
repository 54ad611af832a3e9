# SPDX-License-Identifier: Apache-2.0
"""What is tried before a photo is given up, in which order, and what the attempts say of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import (
    Camera,
    EasySettings,
    LocalizationResult,
    Localizer,
    LocalizerSettings,
    PosePrior,
    RenderedView,
)
from gscpe.arrays import BoolArray, UInt8Array
from gscpe.errors import ModelError
from gscpe.geometry import pose_difference, se3
from gscpe.localization.matchers import Matchers
from gscpe.matching import Matcher, Matches, SiftMatcher
from gscpe.matching.protocol import no_matches

CAMERA = room_camera(240, 180)
TRUTH = np.asarray(se3.exp([0.06, -0.03, 0.05, 0.02, -0.03, 0.01]) @ ROOM_POSE)


class Blind:
    """Matches nothing."""

    def prepare(self, rgb: UInt8Array, valid: BoolArray | None) -> None:
        return None

    def match(self, photo: Any, render: Any) -> Matches:
        return no_matches()


@pytest.fixture(scope="module")
def image() -> NDArray[np.uint8]:
    return room().shoot(CAMERA, TRUTH, samples=2).uint8


def with_matchers(monkeypatch: pytest.MonkeyPatch, **known: Matcher | str) -> None:
    """Stands in for the matchers that are installed; "" is one that is missing."""

    def make(name: str) -> Matcher:
        matcher = known[name.replace("+", "_")]
        if isinstance(matcher, str):
            raise ModelError(f"{name}.onnx is missing")
        return matcher

    monkeypatch.setattr("gscpe.localization.matchers.make_matcher", make)


def tried(result: LocalizationResult) -> list[tuple[str | None, int]]:
    return [(attempt.matcher, attempt.orientation) for attempt in result.attempts]


def localize(image: NDArray[np.uint8], matcher: Any = "xfeat", **settings: Any) -> Any:
    with Localizer(room_map(), LocalizerSettings(**settings), matcher) as localizer:
        return localizer.localize(image, CAMERA)


TURNS = [("xfeat", 6), ("xfeat", 8), ("xfeat", 3)]


def test_nothing_is_tried_without_need(
    image: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch
) -> None:
    with_matchers(monkeypatch, xfeat=SiftMatcher())  # the others would raise KeyError
    result = localize(image)
    assert result.localized
    assert tried(result) == [("xfeat", 1)]


def test_lighterglue_comes_next(image: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch) -> None:
    with_matchers(monkeypatch, xfeat=Blind(), xfeat_lighterglue=SiftMatcher())
    result = localize(image)
    assert result.localized, result.reason
    assert tried(result) == [("xfeat", 1), ("xfeat+lighterglue", 1)]
    assert result.best is not None and result.best.matcher == "xfeat+lighterglue"
    assert "xfeat+lighterglue: ok" in repr(result.attempts[1])


def test_sift_comes_last(image: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch) -> None:
    with_matchers(monkeypatch, xfeat=Blind(), xfeat_lighterglue=Blind(), sift=SiftMatcher())
    result = localize(image)
    assert result.localized, result.reason
    assert tried(result) == [("xfeat", 1), ("xfeat+lighterglue", 1), *TURNS, ("sift", 1)]
    assert result.cam_from_world is not None
    assert pose_difference(result.cam_from_world, TRUTH).distance < 0.01


class Counted(SiftMatcher):
    """Finds nothing, and counts the renders that it was asked to match."""

    def __init__(self) -> None:
        super().__init__()
        self.matched = 0

    def match(self, photo: Any, render: Any) -> Matches:
        self.matched += 1
        return no_matches()


def test_each_start_is_rendered_once(
    image: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch
) -> None:
    """At full size; the small render of a first look is for the first matcher alone."""
    matchers = Counted(), Counted(), Counted()
    with_matchers(monkeypatch, xfeat=matchers[0], xfeat_lighterglue=matchers[1], sift=matchers[2])
    easy = EasySettings(side=90, min_references=1)
    settings = LocalizerSettings(easy=easy, orientations=())
    sizes = []
    with Localizer(room_map(), settings, "xfeat") as localizer:
        render = localizer._renderer.render

        def counted(camera: Camera, pose: NDArray[np.float64]) -> RenderedView:
            sizes.append(camera.height)
            return render(camera, pose)

        monkeypatch.setattr(localizer._renderer, "render", counted)
        assert not localizer.localize(image, CAMERA).localized
        assert not localizer.localize(image, CAMERA).localized
    assert sizes == [90, 180] * 2  # and nothing is kept from photo to photo
    assert [matcher.matched for matcher in matchers] == [4, 2, 2]


def test_a_missing_network_is_noted_and_left_out(
    image: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch
) -> None:
    with_matchers(monkeypatch, xfeat=Blind(), xfeat_lighterglue="", sift=SiftMatcher())
    result = localize(image)
    assert result.localized, result.reason
    assert tried(result) == [("xfeat", 1), ("xfeat+lighterglue", 1), *TURNS, ("sift", 1)]
    note = result.attempts[1]
    assert note.coarse is None and note.aligned is None
    assert note.doubt == ("xfeat+lighterglue was not tried: xfeat+lighterglue.onnx is missing")


def test_in_vain(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reason is that of an attempt, not of what could not be tried."""
    with_matchers(monkeypatch, xfeat=SiftMatcher(), xfeat_lighterglue="", sift=SiftMatcher())
    result = localize(room(77).shoot(CAMERA, ROOM_POSE).uint8)
    assert not result.localized
    assert [name for name, _ in tried(result)][-1] == "sift"
    assert result.reason is not None and "was not tried" not in result.reason


@pytest.mark.parametrize(("escalate", "matcher"), [(False, "xfeat"), (True, Blind())])
def test_a_matcher_alone(
    escalate: bool, matcher: Any, image: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Others do not follow where they are switched off, or where a matcher itself was given."""
    with_matchers(monkeypatch, xfeat=Blind())
    result = localize(image, matcher, escalate=escalate)
    assert not result.localized
    assert len({name for name, _ in tried(result)}) == 1


def test_also_from_a_prior(image: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch) -> None:
    with_matchers(monkeypatch, xfeat=Blind(), xfeat_lighterglue=SiftMatcher())
    with Localizer(room_map(), matcher="xfeat") as localizer:
        result = localizer.localize(image, CAMERA, PosePrior(ROOM_POSE, 0.2, 10.0))
    assert result.localized
    kinds = [(attempt.start.kind, attempt.matcher) for attempt in result.attempts]
    assert kinds[:3] == [
        ("prior", "xfeat"),
        ("reference", "xfeat"),
        ("prior", "xfeat+lighterglue"),
    ]


@pytest.mark.parametrize(
    ("name", "others"),
    [
        ("xfeat", ("xfeat+lighterglue", "sift")),
        ("xfeat+lighterglue", ("sift",)),
        ("sift", ()),
    ],
)
def test_only_what_costs_more_follows(
    name: str, others: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    with_matchers(monkeypatch, **{name.replace("+", "_"): Blind()})
    assert Matchers(name).others == others
    assert Matchers(name, followed=False).others == ()
