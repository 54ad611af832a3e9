# SPDX-License-Identifier: Apache-2.0
"""The same scene in any unit, anywhere: the same poses, to about 1e-6 of the scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import (
    AbsolutePose,
    Alignment,
    Attempt,
    LocalizationResult,
    Localizer,
    LocalizerSettings,
    Map,
    Matches,
    Observer,
    PosePrior,
    References,
    RefinementSettings,
    RenderedView,
)
from gscpe.geometry import pose_difference, se3
from gscpe.scene import open_map, save_map
from gscpe.splats import GaussianScene, read_splat, write_splat

CAMERA = room_camera(240, 180)
ASIDE = se3.exp([0.1, -0.05, 0.08, 0.02, 0.05, -0.02]) @ ROOM_POSE
NEXT = se3.exp([0.02, 0.01, -0.01, 0.004, -0.006, 0.003]) @ ASIDE
NOWHERE = np.zeros(3)
ROOM_SIZE = float(np.linalg.norm(np.ptp(room_map().scene.means, axis=0)))


def photo(pose: NDArray[np.float64]) -> NDArray[np.uint8]:
    return room().shoot(CAMERA, pose).uint8


def moved(
    pose: NDArray[np.float64], scale: float, origin: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The same camera where all is ``scale`` times as long, and then shifted by ``origin``."""
    pose = pose.copy()
    pose[:3, 3] = scale * pose[:3, 3] - pose[:3, :3] @ origin
    return pose


def moved_back(
    pose: NDArray[np.float64], scale: float, origin: NDArray[np.float64]
) -> NDArray[np.float64]:
    pose = pose.copy()
    pose[:3, 3] = (pose[:3, 3] + pose[:3, :3] @ origin) / scale
    return pose


def map_in(unit: float | None, scale: float, origin: NDArray[np.float64], folder: Path) -> Map:
    """The room's map, as one that is built of a splat file and references in that world."""
    plain = room_map()
    scene: GaussianScene = replace(
        plain.scene,
        means=(scale * plain.scene.means.astype(np.float64)).astype(np.float32),
        scales=(scale * plain.scene.scales.astype(np.float64)).astype(np.float32),
        near=0.2,
        origin=origin,
    )
    write_splat(scene, folder / "splat.ply")
    poses = np.stack([moved(pose, scale, origin) for pose in plain.references.cam_from_world])
    references = References(plain.references.names, poses, plain.references.cameras)
    map_ = Map.of(read_splat(folder / "splat.ply"), references, plain.descriptors, unit)
    save_map(map_, folder / "map.gsmap")
    return open_map(folder / "map.gsmap")


def localized(map_: Map, scale: float, origin: NDArray[np.float64]) -> list[LocalizationResult]:
    """A photo, the next one with the first as its prior, and that one from an unsure prior."""
    with Localizer(map_) as localizer:
        first = localizer.localize(photo(ASIDE), CAMERA)
        followed = localizer.localize(photo(NEXT), CAMERA, prior=first)
        unsure = PosePrior(moved(ASIDE, scale, origin), 0.5 * scale, 20.0)
        return [first, followed, localizer.localize(photo(NEXT), CAMERA, prior=unsure)]


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> list[LocalizationResult]:
    """In metres, at the origin."""
    return localized(map_in(1.0, 1.0, NOWHERE, tmp_path_factory.mktemp("known")), 1.0, NOWHERE)


@pytest.fixture(scope="module")
def unknown(tmp_path_factory: pytest.TempPathFactory) -> list[LocalizationResult]:
    """The unit is not known."""
    return localized(map_in(None, 1.0, NOWHERE, tmp_path_factory.mktemp("unknown")), 1.0, NOWHERE)


FAR = np.array([5e5, 5.4e6, 250.0])


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize(
    ("scale", "origin"),
    [(0.001, NOWHERE), (0.1, NOWHERE), (1000.0, NOWHERE), (1.0, FAR), (1.0, np.full(3, 1e7))],
)
def test_units_and_origins_do_not_matter(
    scale: float,
    origin: NDArray[np.float64],
    is_known: bool,
    known: list[LocalizationResult],
    unknown: list[LocalizationResult],
    tmp_path: Path,
) -> None:
    map_ = map_in(1.0 / scale if is_known else None, scale, origin, tmp_path)
    results = localized(map_, scale, origin)
    for here, there in zip(results, known if is_known else unknown, strict=True):
        assert here.localized, here.reason
        assert here.started_from == there.started_from
        assert here.cam_from_world is not None and there.cam_from_world is not None
        pose = moved_back(here.cam_from_world, scale, origin)
        error = pose_difference(pose, there.cam_from_world)
        assert error.distance < 1e-5 * ROOM_SIZE  # float32 splats: 6.1e-6 was the most
        assert error.degrees < 4e-4
        assert here.covariance is not None and there.covariance is not None
        sigmas, expected = (np.sqrt(np.diag(c)) for c in (here.covariance, there.covariance))
        units = np.repeat([scale, 1.0], 3)
        np.testing.assert_allclose(sigmas, units * expected, rtol=1e-2)
    assert [result.started_from for result in results] == ["reference", "tracking", "prior"]


def test_what_is_told_is_of_the_world(tmp_path: Path) -> None:
    """Poses of all stages, depths of renders, references: in the unit of whoever asks."""
    map_ = map_in(None, 10.0, FAR, tmp_path)
    with Localizer(map_) as localizer:
        result = localizer.localize(photo(ASIDE), CAMERA)
        true_pose = moved(ASIDE, 10.0, FAR)
        view = localizer.render(CAMERA, true_pose)
    assert result.coarse is not None and result.aligned is not None and result.best is not None
    for pose in (
        result.cam_from_world,
        result.coarse.cam_from_world,
        result.aligned.cam_from_world,
    ):
        assert pose is not None
        assert pose_difference(pose, true_pose).distance < 0.1
    start = moved(ROOM_POSE, 10.0, FAR)
    assert pose_difference(result.best.start.cam_from_world, start).distance < 1e-6
    assert pose_difference(map_.world_references.cam_from_world[0], start).distance < 1e-6
    np.testing.assert_allclose(view.cam_from_world, true_pose, atol=1e-6)
    true_depth = 10.0 * room().shoot(CAMERA, ASIDE).depth
    seen = view.opacity > 0.9
    assert abs(np.median((view.depth / true_depth)[seen]) - 1.0) < 1e-3


def test_a_small_scene_that_claims_to_be_metric(tmp_path: Path) -> None:
    """2 cm before the camera: the near plane of 3DGS, 0.2, would leave nothing."""
    results = localized(map_in(1.0, 0.01, NOWHERE, tmp_path), 0.01, NOWHERE)
    assert results[0].localized, results[0].reason
    assert results[0].cam_from_world is not None
    pose = moved_back(results[0].cam_from_world, 0.01, NOWHERE)
    assert pose_difference(pose, ASIDE).distance < 5e-3


class Told(Observer):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.rounds: list[tuple[RenderedView, AbsolutePose | None]] = []
        self.anchors: list[RenderedView] = []
        self.steps: list[NDArray[np.float64]] = []
        self.alignments: list[Alignment] = []
        self.attempts: list[Attempt] = []

    def round_done(
        self, view: RenderedView, matches: Matches, estimate: AbsolutePose | None
    ) -> None:
        self.rounds.append((view, estimate))

    def anchor_rendered(self, view: RenderedView) -> None:
        self.anchors.append(view)

    def iterated(self, photo_from_anchor: NDArray[np.float64]) -> None:
        self.steps.append(photo_from_anchor)

    def anchor_aligned(self, alignment: Alignment) -> None:
        self.alignments.append(alignment)

    def attempted(self, attempt: Attempt) -> None:
        self.attempts.append(attempt)


@pytest.mark.parametrize(("scale", "origin"), [(1000.0, NOWHERE), (0.1, FAR)])
def test_observers_are_told_of_the_world(
    scale: float, origin: NDArray[np.float64], tmp_path: Path
) -> None:
    told = Told()
    # Without the mean over all rows, which follows the last alignment.
    settings = LocalizerSettings(refinement=RefinementSettings(rolling_pixels=0))
    with Localizer(map_in(1.0 / scale, scale, origin, tmp_path), settings) as localizer:
        result = localizer.localize(photo(ASIDE), CAMERA, observer=told)
        reference = localizer.map.world_references.cam_from_world[0]
    assert result.coarse is not None and result.aligned is not None
    view, _ = told.rounds[0]
    np.testing.assert_allclose(view.cam_from_world, reference, rtol=1e-9, atol=1e-9)
    shot = room().shoot(view.camera, ROOM_POSE)
    assert np.median(view.depth / shot.depth) == pytest.approx(scale, rel=0.01)
    _, estimate = told.rounds[-1]
    assert estimate is not None
    np.testing.assert_array_equal(estimate.cam_from_world, result.coarse.cam_from_world)
    np.testing.assert_array_equal(estimate.covariance, result.coarse.covariance)
    motion, anchor = told.alignments[-1].photo_from_anchor, told.anchors[-1].cam_from_world
    assert result.aligned.cam_from_world is not None
    aligned = pose_difference(motion @ anchor, result.aligned.cam_from_world)
    assert aligned.distance < 1e-9 * max(scale, float(np.linalg.norm(origin)))
    assert aligned.degrees < 1e-5
    last = pose_difference(told.steps[-1] @ anchor, result.aligned.cam_from_world)
    assert last.distance < 1e-3 * scale
    assert told.attempts[-1].start.cam_from_world == pytest.approx(reference, rel=1e-9)
