# SPDX-License-Identifier: Apache-2.0
"""Whole runs with the real renderer, on the map of one ray-cast RGB-D photo.

The photos are ray-cast too, so nothing but the truth is shared. What is left of the error
(measured over 5 poses: at most 2.7 mm and 0.06 degrees, a fifth of a pixel) is the map's:
its surfels are a pixel wide.
"""

from __future__ import annotations

import multiprocessing
import os
from typing import Any, Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map, room_shot, scaled_pose

from gscpe import LocalizationResult, Localizer, LocalizerSettings
from gscpe.errors import CameraError, MapError, PhotoError, RenderError, SettingsError
from gscpe.geometry import Camera, pose_difference, se3

CAMERA = room_camera(240, 180)


@pytest.fixture(scope="module")
def localizer() -> Iterator[Localizer]:
    with Localizer(room_map()) as localizer:
        yield localizer


def aside(seed: int = 0) -> NDArray[np.float64]:
    """A pose about 10 cm and 3 degrees beside the reference photo's."""
    rng = np.random.default_rng(seed)
    step = rng.normal(size=6)
    step[:3] *= 0.1 / np.linalg.norm(step[:3])
    step[3:] *= np.radians(3.0) / np.linalg.norm(step[3:])
    return np.asarray(se3.exp(step) @ ROOM_POSE)


def photo(pose: NDArray[np.float64], camera: Camera = CAMERA) -> NDArray[np.uint8]:
    return room().shoot(camera, pose, samples=2).uint8


def check(
    result: LocalizationResult,
    truth: NDArray[np.float64],
    scale: float = 1.0,
    distance: float = 4e-3,
    degrees: float = 0.1,
) -> None:
    assert result.localized, result.reason
    assert result.reason is None
    assert result.cam_from_world is not None
    error = pose_difference(scaled_pose(result.cam_from_world, 1.0 / scale), truth)
    assert error.distance < distance
    assert error.degrees < degrees


@pytest.mark.parametrize("seed", range(4))
def test_a_photo_from_beside(seed: int, localizer: Localizer) -> None:
    check(localizer.localize(photo(aside(seed)), CAMERA), aside(seed))


def test_every_rasterizer(backend: str) -> None:
    with Localizer(room_map(), backend=backend) as localizer:
        check(localizer.localize(photo(aside()), CAMERA), aside())


def test_the_mapped_photo_itself(localizer: Localizer) -> None:
    """Where the map was fitted it is exact to a hundredth of a pixel."""
    result = localizer.localize(room_shot().uint8, CAMERA)
    check(result, ROOM_POSE, distance=0.5e-3, degrees=0.012)


def test_all_that_a_result_says(localizer: Localizer) -> None:
    result = localizer.localize(photo(aside()), CAMERA)
    assert result.localized
    assert result.reference == "room.png"
    assert result.cam_from_world is not None
    assert result.cam_from_world.shape == (4, 4)
    assert result.cam_from_world.dtype == np.float64
    np.testing.assert_allclose(
        result.cam_from_world[:3, :3] @ result.cam_from_world[:3, :3].T, np.eye(3), atol=1e-9
    )
    assert result.covariance is not None
    assert result.covariance.shape == (6, 6)
    np.testing.assert_allclose(result.covariance, result.covariance.T, rtol=1e-9)
    assert np.linalg.eigvalsh(result.covariance).min() > 0
    deviations = np.sqrt(np.diag(result.covariance))
    assert np.all((deviations > 1e-5) & (deviations < 0.05))
    assert set(result.seconds) == {*("features", "retrieval", "coarse", "refinement", "total")}
    stages = sum(value for stage, value in result.seconds.items() if stage != "total")
    assert 0 < stages <= result.seconds["total"]
    assert result.coarse is not None
    assert result.aligned is not None
    assert result.coarse.inliers >= 20
    assert result.aligned.agreement > 0.9


def test_the_same_photo_gives_the_same_pose(localizer: Localizer) -> None:
    first, second = (localizer.localize(photo(aside()), CAMERA) for _ in range(2))
    assert first.cam_from_world is not None
    assert second.cam_from_world is not None
    np.testing.assert_array_equal(first.cam_from_world, second.cam_from_world)


@pytest.mark.parametrize("unit", [0.1, None])
def test_units_do_not_matter(unit: float | None, localizer: Localizer) -> None:
    """All lengths tenfold; the unit known, or not."""
    metric = localizer.localize(photo(aside()), CAMERA)
    assert metric.cam_from_world is not None
    assert metric.covariance is not None
    with Localizer(room_map(10.0, unit)) as tenfold:
        scaled = tenfold.localize(photo(aside()), CAMERA)
    check(scaled, aside(), scale=10.0)
    check(scaled, metric.cam_from_world, scale=10.0, distance=1.5e-3, degrees=0.03)
    assert scaled.covariance is not None
    ratio = np.sqrt(np.diag(scaled.covariance) / np.diag(metric.covariance))
    np.testing.assert_allclose(ratio, [10, 10, 10, 1, 1, 1], rtol=0.2)


def test_lens_distortion(localizer: Localizer) -> None:
    """Corners are bent by 4 pixels; taking the photo for a pinhole's costs 4 cm."""
    parameters = [CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, -0.12, 0.03, 0.002, -0.0015]
    camera = Camera.from_colmap("OPENCV", 240, 180, parameters)
    for seed in range(2):
        bent = photo(aside(seed), camera)
        check(localizer.localize(bent, camera), aside(seed))
        ignored = localizer.localize(bent, CAMERA)
        if ignored.cam_from_world is not None:
            assert pose_difference(ignored.cam_from_world, aside(seed)).distance > 0.01


@pytest.mark.parametrize("times", [0.7, 1.4])
def test_a_camera_of_another_resolution(times: float, localizer: Localizer) -> None:
    """The same view with fewer pixels, or with more, has the same pose."""
    camera = CAMERA.resized(round(240 * times), round(180 * times))
    check(localizer.localize(photo(aside(), camera), camera), aside())


def test_grey_and_dim_photos(localizer: Localizer) -> None:
    grey = photo(aside()).mean(axis=2).astype(np.uint8)
    check(localizer.localize(grey, CAMERA), aside(), distance=5e-3)
    dim = np.rint(0.6 * photo(aside()) + 25).astype(np.uint8)
    check(localizer.localize(dim, CAMERA), aside(), distance=5e-3)


NO_PLACES: dict[str, Callable[[], NDArray[np.uint8]]] = {
    "another place": lambda: room(77).shoot(CAMERA, ROOM_POSE).uint8,
    "the room painted anew": lambda: room(5).shoot(CAMERA, ROOM_POSE).uint8,
    "black": lambda: np.zeros((180, 240, 3), np.uint8),
    "white": lambda: np.full((180, 240, 3), 255, np.uint8),
    "noise": lambda: np.random.default_rng(0).integers(0, 256, (180, 240, 3), dtype=np.uint8),
    "looking away": lambda: photo(se3.exp([0, 0, 0, 0, 1.6, 0]) @ ROOM_POSE),
}


@pytest.mark.parametrize("name", NO_PLACES)
def test_photos_of_elsewhere_are_not_localized(name: str, localizer: Localizer) -> None:
    result = localizer.localize(NO_PLACES[name](), CAMERA)
    assert not result.localized
    assert result.reason
    assert result.cam_from_world is None
    assert result.covariance is None
    assert result.seconds["total"] > 0


@pytest.mark.parametrize("size", [(32, 24), (3, 2), (1, 1)])
def test_tiny_photos_are_not_localized(size: tuple[int, int], localizer: Localizer) -> None:
    """32x24 was once localized a pixel off, which is 8 cm in the room and 5.6 of its sigmas."""
    camera = CAMERA.resized(*size)
    result = localizer.localize(photo(ROOM_POSE, camera), camera)
    assert not result.localized
    assert result.reason == (
        f"the photo has only {size[0]}x{size[1]} pixels; 48 are needed on its shorter side"
    )


def test_wrong_input(localizer: Localizer) -> None:
    with pytest.raises(CameraError, match="the photo is 240x180, but its camera is 120x90"):
        localizer.localize(photo(ROOM_POSE), room_camera(120, 90))
    with pytest.raises(PhotoError, match=r"must be .* uint8 RGB, not float64"):
        localizer.localize(photo(ROOM_POSE) / 255.0, CAMERA)  # type: ignore[arg-type]
    with pytest.raises(MapError, match="references is empty"):
        localizer.localize(photo(ROOM_POSE), CAMERA, references=[])


def test_a_closed_localizer_says_so() -> None:
    localizer = Localizer(room_map())
    localizer.close()
    localizer.close()
    with pytest.raises(RenderError, match="closed"):
        localizer.localize(photo(ROOM_POSE), CAMERA)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_localizer_does_not_survive_a_fork(localizer: Localizer) -> None:
    """Its threads stay behind; a forked process would wait for them for ever."""
    localizer.localize(photo(ROOM_POSE), CAMERA)
    context = multiprocessing.get_context("fork")
    answers = context.Queue()

    def localize(answers: Any) -> None:
        try:
            localizer.localize(photo(ROOM_POSE), CAMERA)
        except RenderError as error:
            answers.put(str(error))

    worker = context.Process(target=localize, args=(answers,))
    worker.start()
    try:
        assert "make one in each process" in answers.get(timeout=60)
    finally:
        worker.kill()
        worker.join()


def test_it_can_also_render(localizer: Localizer) -> None:
    view = localizer.render(CAMERA, ROOM_POSE)
    seen = view.opacity > 0.9
    assert seen.mean() > 0.95
    assert np.median(np.abs(view.depth - room_shot().depth)[seen]) < 3e-3


def test_impossible_settings() -> None:
    with pytest.raises(SettingsError, match="hypotheses must be"):
        LocalizerSettings(hypotheses=0)
    with pytest.raises(SettingsError, match="retrieved is 2, hypotheses 3"):
        LocalizerSettings(hypotheses=3, retrieved=2)
    with pytest.raises(SettingsError, match="EXIF orientations, 1 to 8"):
        LocalizerSettings(orientations=(9,))
