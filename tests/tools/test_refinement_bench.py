# SPDX-License-Identifier: Apache-2.0
"""What tools/bench_refinement.py makes of photos, starts and times."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray
from scenes import ROOM_POSE, RayCastRenderer, World, room, room_camera

from gscpe.geometry import Camera, pose_difference, se3
from gscpe.photos import Photo
from gscpe.refinement import RefinementSettings, VisibilitySettings, refine_pose
from gscpe.render import RenderedView

Tool = Callable[[str], Any]


@pytest.fixture
def image(rng: np.random.Generator) -> NDArray[np.uint8]:
    return rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)


def test_all_changes_keep_the_kind_of_image(tool: Tool, image: NDArray[np.uint8]) -> None:
    for name, change in tool("changed_photos").CHANGES.items():
        before = image.copy()
        changed = change(image)
        assert changed.shape == image.shape, name
        assert changed.dtype == np.uint8, name
        assert np.any(changed != image), name
        np.testing.assert_array_equal(image, before, name)
        np.testing.assert_array_equal(change(image), changed, name)


def test_exposure(tool: Tool, image: NDArray[np.uint8]) -> None:
    photos = tool("changed_photos")
    bright = photos.exposed(image, 2.0)
    assert np.all(bright[image >= 128] == 255)
    np.testing.assert_array_equal(bright[image < 128], 2 * image[image < 128])
    assert photos.exposed(image, 0.5).mean() == pytest.approx(0.5 * image.mean(), abs=0.5)
    np.testing.assert_array_equal(photos.exposed(image, 1.0), image)


def test_gamma(tool: Tool) -> None:
    ends_and_middle = np.array([[[0, 255, 128]]], dtype=np.uint8)
    photos = tool("changed_photos")
    for gamma, middle in ((0.7, 157), (1.4, 97), (1.0, 128)):
        np.testing.assert_array_equal(
            photos.with_gamma(ends_and_middle, gamma), [[[0, 255, middle]]]
        )


def test_colour_cast(tool: Tool, image: NDArray[np.uint8]) -> None:
    cast = tool("changed_photos").colour_cast(image, 1.0, 0.5, 2.0)
    np.testing.assert_array_equal(cast[:, :, 0], image[:, :, 0])
    np.testing.assert_allclose(cast[:, :, 1], image[:, :, 1] / 2, atol=0.5)
    np.testing.assert_array_equal(cast[:, :, 2], np.minimum(2 * image[:, :, 2].astype(int), 255))


def test_vignetting(tool: Tool) -> None:
    """cos^4 of a lens whose corner is at 40%: there tan^2 is 0.4^-0.5 - 1; half way to the
    corner it is a quarter of that."""
    grey = np.full((401, 601, 3), 200, dtype=np.uint8)
    dark = tool("changed_photos").vignetted(grey, 0.4)
    assert dark[200, 300, 0] == 200
    corners = dark[[0, 0, -1, -1], [0, -1, 0, -1]]
    np.testing.assert_allclose(corners, 80, atol=1)
    half_way = 200 * np.cos(np.arctan(0.5 * np.sqrt(0.4**-0.5 - 1))) ** 4
    np.testing.assert_allclose(dark[100, 150], half_way, atol=1)


def test_noise(tool: Tool) -> None:
    grey = np.full((100, 100, 3), 128, dtype=np.uint8)
    error = tool("changed_photos").noisy(grey, 8.0).astype(float) - 128
    assert error.std() == pytest.approx(8.0, rel=0.02)
    assert abs(error.mean()) < 0.2


def test_motion_blur_is_centred(tool: Tool) -> None:
    point = np.zeros((9, 15, 3), dtype=np.uint8)
    point[4, 7] = 250
    blurred = tool("changed_photos").motion_blurred(point, 5)
    expected = np.zeros_like(point)
    expected[4, 5:10] = 50
    np.testing.assert_array_equal(blurred, expected)


def test_a_quarter_is_covered(tool: Tool) -> None:
    black = np.zeros((120, 160, 3), dtype=np.uint8)
    covered = tool("changed_photos").occluded(black, 0.25)
    rows, columns = (np.flatnonzero(covered.any(axis=axis).any(axis=1)) for axis in (1, 0))
    assert np.ptp(rows) + 1 == 60
    assert np.ptp(columns) + 1 == 80
    assert covered[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].std() > 20


def test_displaced_starts_are_as_far_off_as_they_say(tool: Tool, rng: np.random.Generator) -> None:
    methods, shifts = tool("refinement_methods"), []
    for _ in range(50):
        pose = random_pose(rng)
        start = methods.displaced(pose, 0.03, 1.5, rng)
        difference = pose_difference(start, pose)
        assert difference.distance == pytest.approx(0.03)
        assert difference.degrees == pytest.approx(1.5)
        shifts.append(se3.log(start @ se3.inverse(pose))[:3])
    assert np.linalg.norm(np.mean(shifts, axis=0)) < 0.3 * np.linalg.norm(shifts, axis=1).mean()


def test_recorded_refinement_is_the_same_refinement(tool: Tool) -> None:
    """It ends where refine_pose does, renders as often, and its times add up."""
    camera = room_camera(160, 120)
    photo = Photo(room().shoot(camera, ROOM_POSE).uint8, camera)
    start = se3.exp([0.03, -0.02, 0.02, 0.01, -0.02, 0.01]) @ ROOM_POSE
    settings = RefinementSettings(visibility=VisibilitySettings(views=2))
    plain, renderer = RayCastRenderer(room()), SlowRenderer(room())
    expected = refine_pose(plain, photo, start, settings)
    assert expected.cam_from_world is not None
    track = tool("refinement_methods").lucas_kanade(settings).run(renderer, photo, start)
    np.testing.assert_array_equal(track.cam_from_world[0], start)
    np.testing.assert_array_equal(track.cam_from_world[-1], expected.cam_from_world)
    assert renderer.renders == plain.renders == 3 * expected.anchors  # one, and two views of it
    # Whatever rendering takes is not the solver's.
    assert track.seconds[-1] - track.solver_seconds[-1] >= renderer.renders * renderer.seconds
    assert np.all(np.diff(track.seconds) >= 0)
    assert np.all(np.diff(track.solver_seconds) >= 0)
    # On its way it comes nearer: every iteration is there.
    distances = [pose_difference(p, ROOM_POSE).distance for p in track.cam_from_world]
    assert len(distances) > 6
    assert distances[-1] < 0.01 * distances[0]


def test_a_refinement_that_fails_has_no_trajectory(tool: Tool) -> None:
    camera = room_camera(160, 120)
    photo = Photo(np.full((120, 160, 3), 128, np.uint8), camera)
    away = se3.exp([0, 0, 0, 0, np.pi, 0]) @ ROOM_POSE
    method = tool("refinement_methods").lucas_kanade(RefinementSettings())
    assert method.run(RayCastRenderer(World(())), photo, away) is None


@dataclass
class SlowRenderer(RayCastRenderer):
    """Takes at least so long, and longer than the solver."""

    seconds: float = 0.01

    def render(self, camera: Camera, cam_from_world: NDArray[np.float64]) -> RenderedView:
        time.sleep(self.seconds)
        return super().render(camera, cam_from_world)


def course(tool: Tool, *tracks: tuple[list[float], list[float]]) -> Any:
    """Of (seconds, centimetres) of several queries; degrees are a tenth of the centimetres."""
    methods, compare = tool("refinement_methods"), tool("refinement_compare")
    trajectories = [
        methods.Trajectory(5 + np.array(s), np.array(s), np.zeros((len(s), 4, 4)))
        for s, _ in tracks
    ]
    errors = [np.array([[e, 0.1 * e] for e in of_track]) for _, of_track in tracks]
    return compare.Course(trajectories, errors, False)


def test_median_error_against_time(tool: Tool) -> None:
    """An error holds until the next pose, and after the last."""
    both = course(tool, ([0, 1, 4], [3, 2, 1]), ([0, 2], [3, 1]), ([0, 3], [3, 0.5]))
    np.testing.assert_allclose(both.seconds, [0, 1, 2, 3, 4])
    np.testing.assert_allclose(both.errors[:, 0], [3, 3, 2, 1, 1])
    np.testing.assert_allclose(both.errors[:, 1], 0.1 * both.errors[:, 0])
    assert both.end == 3


def test_when_a_target_is_reached_for_good(tool: Tool) -> None:
    there_and_back = course(tool, ([0, 1, 2, 3], [4, 1, 2, 1]))
    assert there_and_back.reaches(np.array([1.0, 0.1])) == 3
    assert there_and_back.reaches(np.array([2.0, 0.2])) == 1
    assert there_and_back.reaches(np.array([2.0, 0.1])) == 3  # degrees count too
    assert there_and_back.reaches(np.array([4.0, 0.4])) == 0
    assert there_and_back.reaches(np.array([0.9, 0.1])) == np.inf


def test_every_variant_leaves_out_one_thing(tool: Tool) -> None:
    full = RefinementSettings()
    variants = tool("refinement_parts").variants(full)
    assert variants.pop("full") == full
    assert len(set(map(repr, variants.values())) | {repr(full)}) == len(variants) + 1


def test_plots(tool: Tool, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    tool("refinement_compare").draw({"a": [1.0, 1.0, 0.5, 0.2, 0.0]}, tmp_path / "in" / "basin.png")
    covariance = tool("bench_covariance")
    kinds = [covariance.Kind("a"), covariance.Kind("b")]
    for kind in kinds:
        kind.normalized["final"] = [1.0, 5.0, 90.0]
    covariance.draw(kinds, tmp_path / "in" / "nees.png")
    for name in ("basin", "nees"):
        data = (tmp_path / "in" / f"{name}.png").read_bytes()
        assert data.startswith(b"\x89PNG")
        assert len(data) < 80_000
