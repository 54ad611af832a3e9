# SPDX-License-Identifier: Apache-2.0
"""Priors: they save work where they are good, and harm nothing where they are not."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import (
    Attempt,
    Localizer,
    LocalizerSettings,
    Observer,
    PosePrior,
    References,
    Start,
    open_map,
    save_map,
)
from gscpe.errors import MapError, PoseError
from gscpe.geometry import pose_difference, se3
from gscpe.geometry.pose_error import camera_centre
from gscpe.localization.starts import different_places, near_the_prior_first
from gscpe.mapping import map_without_references
from gscpe.retrieval import RetrievedReference, open_describer

CAMERA = room_camera(240, 180)
TRUTH = np.asarray(se3.exp([0.06, -0.03, 0.05, 0.02, -0.03, 0.01]) @ ROOM_POSE)


@pytest.fixture(scope="module")
def localizer() -> Iterator[Localizer]:
    with Localizer(room_map()) as localizer:
        yield localizer


@pytest.fixture(scope="module")
def image() -> NDArray[np.uint8]:
    return room().shoot(CAMERA, TRUTH, samples=2).uint8


def moved(metres: float, degrees: float) -> NDArray[np.float64]:
    step = [metres, 0, 0, 0, np.radians(degrees), 0]
    return np.asarray(se3.exp(step) @ TRUTH)


def is_found(cam_from_world: NDArray[np.float64] | None) -> bool:
    if cam_from_world is None:
        return False
    error = pose_difference(cam_from_world, TRUTH)
    return error.distance < 4e-3 and error.degrees < 0.1


def test_a_near_prior_needs_no_coarse_stage(localizer: Localizer, image: NDArray[np.uint8]) -> None:
    result = localizer.localize(image, CAMERA, prior=PosePrior(moved(0.02, 0.7)))
    assert result.started_from == "tracking"
    assert result.coarse is None
    assert result.reference is None
    assert set(result.seconds) == {"refinement", "total"}
    assert is_found(result.cam_from_world)


def test_an_unsure_prior_needs_no_retrieval(localizer: Localizer, image: NDArray[np.uint8]) -> None:
    prior = PosePrior(moved(0.2, 8.0), translation_sigma=0.3, rotation_sigma_degrees=10.0)
    result = localizer.localize(image, CAMERA, prior=prior)
    assert result.started_from == "prior"
    assert "retrieval" not in result.seconds
    assert is_found(result.cam_from_world)


@pytest.mark.parametrize(
    "wrong",
    [
        se3.exp([0, 0, 0, 0, np.pi, 0]) @ TRUTH,
        se3.exp([50.0, 0, 0, 0, 0, 0]) @ TRUTH,
        se3.exp([0.5, 0, 0, 0, 0.5, 0]) @ TRUTH,
    ],
    ids=["behind", "outside the map", "too sure"],
)
def test_a_wrong_prior_is_overcome(
    wrong: NDArray[np.float64], localizer: Localizer, image: NDArray[np.uint8]
) -> None:
    result = localizer.localize(image, CAMERA, prior=PosePrior(wrong))
    assert result.localized, result.reason
    assert is_found(result.cam_from_world)
    assert len(result.attempts) >= 2


def test_a_prior_does_not_make_another_place_this_one(localizer: Localizer) -> None:
    elsewhere = room(77).shoot(CAMERA, ROOM_POSE).uint8
    result = localizer.localize(elsewhere, CAMERA, prior=PosePrior(ROOM_POSE))
    assert not result.localized
    assert result.cam_from_world is None
    assert result.reason


def test_frame_after_frame(localizer: Localizer) -> None:
    """The first frame is found by retrieval, the others from the one before."""
    starts, result = [], None
    for step in range(4):
        pose = se3.exp([0.015 * step, 0, 0.01 * step, 0, 0.01 * step, 0]) @ TRUTH
        frame = room().shoot(CAMERA, pose, samples=2).uint8
        result = localizer.localize(frame, CAMERA, prior=result)
        assert result.cam_from_world is not None, result.reason
        assert pose_difference(result.cam_from_world, pose).distance < 5e-3
        starts.append(result.started_from)
    assert starts == ["reference", "tracking", "tracking", "tracking"]


def test_a_lost_frame_is_no_prior(localizer: Localizer, image: NDArray[np.uint8]) -> None:
    lost = localizer.localize(np.zeros_like(image), CAMERA)
    assert not lost.localized
    assert localizer.localize(image, CAMERA, prior=lost).started_from == "reference"


@pytest.mark.parametrize("compress", [False, True])
def test_a_map_without_references_needs_a_prior(
    compress: bool, image: NDArray[np.uint8], tmp_path: Path
) -> None:
    if compress:
        pytest.importorskip("gaussforge", reason="compressed maps need gaussforge")
    save_map(map_without_references(room_map().scene), tmp_path / "map", compress=compress)
    with Localizer(open_map(tmp_path / "map")) as localizer:
        with pytest.raises(MapError, match="give a prior pose"):
            localizer.localize(image, CAMERA)
        found = localizer.localize(image, CAMERA, prior=PosePrior(moved(0.03, 1.0)))
        assert is_found(found.cam_from_world)
        away = PosePrior(np.asarray(se3.exp([50.0, 0, 0, 0, 0, 0]) @ TRUTH))
        lost = localizer.localize(image, CAMERA, prior=away)
        assert not lost.localized
        assert lost.reason


def test_impossible_priors() -> None:
    with pytest.raises(PoseError, match="rigid"):
        PosePrior(2.0 * np.eye(4))
    for sigma in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(PoseError, match="positive and finite"):
            PosePrior(np.eye(4), translation_sigma=sigma)


def test_deviations_are_numbers() -> None:
    wrong: Any
    for wrong in ([0.1, 0.1, 0.2], np.array([0.1, 0.1, 0.2])):
        with pytest.raises(PoseError, match="one number for all directions"):
            PosePrior(np.eye(4), translation_sigma=wrong)
        with pytest.raises(PoseError, match="one number for all directions"):
            PosePrior(np.eye(4), rotation_sigma_degrees=wrong)
    for wrong in ("near", None):
        with pytest.raises(PoseError, match="positive and finite"):
            PosePrior(np.eye(4), translation_sigma=wrong)
    assert PosePrior(np.eye(4), np.float32(0.5)).translation_sigma == 0.5  # type: ignore[arg-type]


def test_a_prior_keeps_a_copy() -> None:
    pose = np.eye(4)
    prior = PosePrior(pose)
    pose[0, 3] = 7.0
    assert prior.cam_from_world[0, 3] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        prior.cam_from_world[0, 3] = 7.0
    nested: Any = [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    from_list = PosePrior(nested).cam_from_world
    assert from_list.dtype == np.float64
    np.testing.assert_array_equal(from_list, nested)
    nested[0] = [1, 0.1, 0, 1]
    wrong: Any
    for wrong in (nested, [1, 2, 3], "here", np.full((4, 4), np.nan)):
        with pytest.raises(PoseError, match="the prior's cam_from_world"):
            PosePrior(wrong)


def test_a_position_is_where_the_camera_stands() -> None:
    prior = PosePrior.at([1.0, 2.0, 3.0], 4.0)
    np.testing.assert_allclose(camera_centre(prior.cam_from_world), [1.0, 2.0, 3.0])
    assert (prior.translation_sigma, prior.rotation_sigma_degrees) == (4.0, 180.0)
    wrong: Any
    for wrong in ([1.0, 2.0], np.eye(4), "here", [1.0, 2.0, np.nan]):
        with pytest.raises(PoseError):
            PosePrior.at(wrong, 1.0)


def test_a_position_alone_is_no_pose_to_render_from(
    localizer: Localizer, image: NDArray[np.uint8]
) -> None:
    prior = PosePrior.at(camera_centre(TRUTH), 0.5)
    result = localizer.localize(image, CAMERA, prior=prior)
    assert result.started_from == "reference"
    assert is_found(result.cam_from_world)
    alone = map_without_references(room_map().scene)
    with Localizer(alone) as without, pytest.raises(MapError, match="give a prior pose"):
        without.localize(image, CAMERA, prior=prior)


def test_a_position_decides_between_places_that_look_alike(
    localizer: Localizer, image: NDArray[np.uint8]
) -> None:
    """References near the position come first, also where others are more similar, and where
    they are beyond the number that is retrieved otherwise."""
    tried: list[Start] = []

    class Starts(Observer):
        def attempted(self, attempt: Attempt) -> None:
            tried.append(attempt.start)

    poses = np.stack([se3.exp([-0.3 * x, 0, 0, 0, 0, 0]) @ ROOM_POSE for x in range(5)])
    ours = localizer.map
    # A shorter descriptor is less similar: a before b, and so on.
    described = open_describer(ours.descriptors, None).describe(image, None, None)
    rows = np.linspace(1.0, 0.9, 5, dtype=np.float32)[:, None] * described
    alike = replace(
        ours,
        references=References(tuple("abcde"), poses, ours.references.cameras[:1] * 5),
        descriptors=replace(ours.descriptors, descriptors=rows),
    )
    settings = LocalizerSettings(hypotheses=1, retrieved=1, same_place=0.1)
    with Localizer(alike, settings) as one:
        one.localize(image, CAMERA, observer=Starts())
        prior = PosePrior.at(camera_centre(poses[3]), 0.01)
        one.localize(image, CAMERA, prior=prior, observer=Starts())
    assert [start.reference for start in tried] == ["a", "d"]


def retrieved(*indices: int) -> list[RetrievedReference]:
    return [RetrievedReference(index, 1.0 - 0.1 * rank) for rank, index in enumerate(indices)]


def test_places_differ_by_where_they_are_or_where_they_look() -> None:
    poses = np.stack(
        [
            np.eye(4),
            se3.exp([0.1, 0, 0, 0, 0.1, 0]),  # beside the first
            se3.exp([0.1, 0, 0, 0, 2.0, 0]),  # looks elsewhere
            se3.exp([5.0, 0, 0, 0, 0, 0]),  # is elsewhere
        ]
    )
    places = different_places(retrieved(1, 0, 3, 2), poses, same_place=0.5, same_place_degrees=30.0)
    assert [place.index for place in places] == [1, 3, 2]


def test_look_alikes_in_front_hide_no_place() -> None:
    """A video stood still at one place: 500 frames of it rank before all others."""
    still = [se3.exp([1e-3 * i, 0, 0, 0, 0, 0]) for i in range(500)]
    others = [se3.exp([3.0, 0, 0, 0, 0, 0]), se3.exp([-3.0, 0, 0, 0, 0, 0])]
    poses = np.stack([*still, *others])
    asked: list[int] = []

    def ranking() -> Iterator[RetrievedReference]:
        for index in range(len(poses)):
            asked.append(index)
            yield RetrievedReference(index, 1.0)

    places = different_places(ranking(), poses, same_place=0.5, same_place_degrees=30.0)
    assert [place.index for place in islice(places, 1)] == [0]
    assert asked == [0]  # no more than is needed
    assert [place.index for place in places] == [500, 501]


@given(seed=st.integers(0, 2**32 - 1))
def test_places_are_told_apart_as_poses_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = np.stack([se3.exp(rng.normal(scale=0.4, size=6)) for _ in range(12)])
    ranking = retrieved(*rng.permutation(12).tolist())
    found = [p.index for p in different_places(ranking, poses, 0.7, 40.0)]
    expected: list[int] = []
    for each in ranking:
        apart = [pose_difference(poses[each.index], poses[other]) for other in expected]
        if not any(a.distance < 0.7 and a.degrees < 40.0 for a in apart):
            expected.append(each.index)
    assert found == expected


def test_the_prior_reorders_but_removes_nothing() -> None:
    poses = np.stack([se3.exp([-float(x), 0, 0, 0, 0, 0]) for x in range(5)])
    prior = PosePrior(poses[3], translation_sigma=0.3)
    ordered = near_the_prior_first(retrieved(0, 4, 1, 2, 3), poses, prior, reach=1.4)
    assert [each.index for each in ordered] == [4, 2, 3, 0, 1]
