# SPDX-License-Identifier: Apache-2.0
"""The covariance of an alignment, against errors that are known.

NEES is the squared error in units of the covariance; 6 on average when it is right.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Iterable, Iterator

import numpy as np
import pytest
from helpers import numeric_jacobian
from numpy.typing import NDArray
from scenes import ROOM_POSE, away_from_creases, room, room_camera
from scipy.ndimage import gaussian_filter, map_coordinates

from gscpe.errors import SettingsError
from gscpe.geometry import se3
from gscpe.photos import luminance
from gscpe.refinement.lucas_kanade import Alignment, align
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.robust import tukey_curvature, tukey_weights
from gscpe.refinement.sampling import sample_bilinear
from gscpe.refinement.solver_settings import LucasKanadeSettings
from gscpe.refinement.template import build_template, warp
from gscpe.refinement.uncertainty import (
    PoseUncertainty,
    UncertaintySettings,
    pose_uncertainty,
)

CAMERA = room_camera(160, 120)
SOLVER = LucasKanadeSettings()
WORLD = room(smoothness=2.0)
SHOT = WORLD.shoot(CAMERA, ROOM_POSE)
GREY = luminance(SHOT.rgb.astype(np.float32))
RESIDUALS = UncertaintySettings(least_pixels=0.0)
"""What residuals tell, and nothing else."""
ROLLED = np.array([0.0, 0.0, 0.0, 0.02, -0.1, 1.3])


def uncertainty(
    photo: NDArray[np.floating],
    anchor: NDArray[np.floating] = GREY,
    start: NDArray[np.float64] | None = None,
    settings: UncertaintySettings | None = None,
    solver: LucasKanadeSettings = SOLVER,
) -> tuple[Alignment, PoseUncertainty]:
    """Aligns the anchor with a photo and says how sure that is."""
    level = AnchorLevel(anchor.astype(np.float32), away_from_creases(SHOT), CAMERA, SHOT.depth)
    template = build_template(level, solver)
    assert template is not None
    image = ImageLevel(photo.astype(np.float32), np.ones(photo.shape, bool), CAMERA)
    pose = np.eye(4) if start is None else se3.exp(start)
    found = align(template, image, pose, 1.0, 0.0, solver)
    assert found is not None
    settings = settings or UncertaintySettings()
    return found, pose_uncertainty(template, image, found, solver, settings)


def solve(photo: NDArray[np.floating], **arguments: Any) -> tuple[Alignment, NDArray[np.float64]]:
    """The same, and only the covariance."""
    found, sure = uncertainty(photo, **arguments)
    return found, sure.covariance


def information_of_pixels(
    found: Alignment, photo: NDArray[np.floating], anchor: NDArray[np.floating] = GREY
) -> NDArray[np.float64]:
    """J^T J / sigma^2 of independent pixels, from numeric derivatives by xi of
    ``exp(xi) @ photo_from_anchor``, less what gain and bias can explain; of a photo without
    noise."""
    level = AnchorLevel(anchor.astype(np.float32), away_from_creases(SHOT), CAMERA, SHOT.depth)
    template = build_template(level, SOLVER)
    assert template is not None
    image, valid = photo.astype(np.float32), np.ones(photo.shape, bool)

    def intensities(xi: NDArray[np.float64]) -> NDArray[np.float64]:
        u, v, _ = warp(template.points, se3.exp(xi) @ found.photo_from_anchor, CAMERA)
        values, inside = sample_bilinear(image, valid, u, v)
        return np.where(inside, values, 0.0).astype(np.float64)

    u, v, _ = warp(template.points, found.photo_from_anchor, CAMERA)
    inner = (u > 3) & (v > 3) & (u < CAMERA.width - 3) & (v < CAMERA.height - 3)
    jacobian = numeric_jacobian(intensities, np.zeros(6), step=2e-3)[inner]
    light = np.stack([template.intensities[inner], np.ones(inner.sum())], axis=1)
    light = light.astype(np.float64)
    jacobian = jacobian - light @ np.linalg.lstsq(light, jacobian, rcond=None)[0]
    return np.asarray(jacobian.T @ jacobian / found.residual**2)


def nees(
    photos: Iterable[NDArray[np.floating]], settings: UncertaintySettings | None = None
) -> float:
    """Mean over photos that were taken from where the anchor was."""
    values = []
    for photo in photos:
        found, covariance = solve(photo, settings=settings)
        xi = se3.log(se3.inverse(found.photo_from_anchor))
        values.append(xi @ np.linalg.solve(covariance, xi))
    return float(np.mean(values))


def noisy(sigma_pixels: float, count: int = 40) -> Iterator[NDArray[np.float64]]:
    """Photos with noise of that correlation length."""
    rng = np.random.default_rng(1)
    for _ in range(count):
        noise = rng.normal(size=GREY.shape)
        if sigma_pixels:
            noise = gaussian_filter(noise, sigma_pixels)
        yield GREY + 0.02 * noise / noise.std()


def bent(sigma_pixels: float, count: int = 40) -> Iterator[NDArray[np.float64]]:
    """Photos of a scene that is a little elsewhere than the map says, by a sixth of a pixel, and
    by about as much for so many pixels."""
    rng = np.random.default_rng(3)
    rows, columns = np.indices(GREY.shape).astype(np.float64)
    for _ in range(count):
        by = [gaussian_filter(rng.normal(size=GREY.shape), sigma_pixels) for _ in range(2)]
        down, right = (0.15 * each / each.std() for each in by)
        seen = map_coordinates(GREY, [rows + down, columns + right], order=3, mode="nearest")
        yield seen + 0.01 * rng.normal(size=GREY.shape)


@pytest.mark.parametrize("sigma", [0.0, 2.0, 4.0])
def test_noise_of_any_grain(sigma: float) -> None:
    """How far pixels hang together is measured in each photo (measured: 4.0, 5.9 and 5.9). What is
    known of independent pixels would have it above 100 where they are not."""
    assert 3.0 < nees(noisy(sigma), RESIDUALS) < 8.0


@pytest.mark.parametrize(("sigma", "most"), [(4.0, 12.0), (8.0, 17.0), (16.0, 30.0)])
def test_a_bent_map(sigma: float, most: float) -> None:
    """What is bent over a tenth of the picture and more is half hidden in the pose: it is told the
    less, the farther it reaches (measured: 8.5, 12 and 21). That is what ``least_pixels`` is for.
    """
    photos = list(bent(sigma))
    assert 3.0 < nees(photos, RESIDUALS) < most
    assert nees(photos) < 0.7 * nees(photos, RESIDUALS)


def test_what_reaches_farther_than_the_blocks_is_seen() -> None:
    """Were blocks taken for independent, a wide bend would be told less (109 in place of 51)."""
    photos = list(bent(24.0, 20))
    assert nees(photos, RESIDUALS) < 0.7 * nees(photos, replace(RESIDUALS, reach=1.0))


@pytest.mark.parametrize("wrong", [0.5, float("nan"), float("inf")])
def test_a_reach_is_of_blocks(wrong: float) -> None:
    with pytest.raises(SettingsError, match="reach"):
        UncertaintySettings(reach=wrong)


@pytest.mark.parametrize(("degrees_of_freedom", "least"), [(1, 1.5), (4, 4.2)])
def test_heavy_tailed_noise(degrees_of_freedom: int, least: float) -> None:
    """Independent pixels, which the estimate is right for as it is: 6. Without the curvature of
    Tukey's loss it would be bold (measured: 7.7 with four degrees of freedom). With one, where
    hardly a gradient is shared beyond chance, it is careful."""
    rng = np.random.default_rng(1)
    photos = (GREY + 0.02 * rng.standard_t(degrees_of_freedom, size=GREY.shape) for _ in range(60))
    assert least < nees(photos, RESIDUALS) < 9.0


def test_it_is_of_a_step_on_the_photos_side(rng: np.random.Generator) -> None:
    """The photo is rolled by 75 degrees, so that the anchor's side has other axes; from the same
    place, where the anchor's Jacobian is exact at any turn."""
    photo = luminance(WORLD.shoot(CAMERA, se3.exp(ROLLED) @ ROOM_POSE).rgb.astype(np.float32))
    settings = UncertaintySettings(shrinkage=1.0, least_pixels=0.0)
    found, covariance = solve(
        photo + 0.02 * rng.normal(size=photo.shape), start=ROLLED, settings=settings
    )
    # With all shrunk, the shape is that of independent pixels.
    information = information_of_pixels(found, photo)
    assert spread_of(covariance @ information) < 1.8
    back = se3.adjoint(se3.inverse(found.photo_from_anchor))
    assert spread_of(back @ covariance @ back.T @ information) > 3.0


def spread_of(product: NDArray[np.float64]) -> float:
    """Ratio of the largest eigenvalue to the smallest."""
    values = np.abs(np.linalg.eigvals(product))
    return float(values.max() / values.min())


def test_a_perfect_fit_is_not_known_perfectly() -> None:
    _, covariance = solve(GREY)
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert np.sqrt(covariance[3, 3]) * CAMERA.fx > 0.01  # pixels


def test_noise_is_in_it(rng: np.random.Generator) -> None:
    """Three times the noise, three times the deviation at least."""
    noise = rng.normal(size=GREY.shape)
    (_, quiet), (_, loud) = (solve(GREY + s * noise, settings=RESIDUALS) for s in (0.005, 0.015))
    ratio = np.sqrt(np.trace(loud[:3, :3]) / np.trace(quiet[:3, :3]))
    assert 2.7 < ratio < 6.0


def test_noise_in_the_render_is_no_texture(rng: np.random.Generator) -> None:
    """Nothing but noise varies down the picture: how high the camera is, cannot be told."""
    stripes = np.broadcast_to(GREY.mean(axis=0), GREY.shape)
    noise = [0.01 * rng.normal(size=GREY.shape) for _ in range(2)]
    _, covariance = solve(stripes + noise[0], anchor=stripes + noise[1])
    _, textured = solve(GREY + noise[0], anchor=GREY + noise[1])
    assert covariance[1, 1] > 30.0 * textured[1, 1]
    assert covariance[0, 0] > textured[0, 0]
    np.testing.assert_allclose(covariance, covariance.T)


def test_a_blank_photo_is_no_evidence() -> None:
    _, covariance = solve(np.full(GREY.shape, 0.5))
    assert np.sqrt(np.trace(covariance[:3, :3])) > 1.0  # metres


@pytest.mark.parametrize("smoothness", [0.0, 0.8])
def test_chance_is_no_texture(smoothness: float) -> None:
    """Of forty pairs of noise, many seem to agree a little: none may count, fine or coarse."""
    rng = np.random.default_rng(4)
    stripes = np.broadcast_to(GREY.mean(axis=0), GREY.shape)
    _, textured = solve(GREY, anchor=GREY + 0.01 * rng.normal(size=GREY.shape))
    for _ in range(40):
        noise = [gaussian_filter(rng.normal(size=GREY.shape), smoothness) for _ in range(2)]
        photo, anchor = (stripes + 0.01 * each / each.std() for each in noise)
        _, covariance = solve(photo, anchor=anchor)
        assert np.sqrt(covariance[1, 1] / textured[1, 1]) > 100.0


def test_what_photo_and_render_do_not_share(rng: np.random.Generator) -> None:
    """It is a part of the covariance; nearly all of it along stripes, little of it elsewhere."""
    stripes = np.broadcast_to(GREY.mean(axis=0), GREY.shape)
    noise = [0.01 * rng.normal(size=GREY.shape) for _ in range(2)]
    for image, direction, low, high in (
        (stripes, 1, 0.99, 1.0),
        (GREY, 1, 0.0, 0.5),
        (GREY, 0, 0.0, 0.5),
    ):
        found = uncertainty(image + noise[0], anchor=image + noise[1])[1]
        share = found.unshared[direction, direction] / found.covariance[direction, direction]
        assert low <= share <= high
        np.testing.assert_allclose(found.unshared, found.unshared.T)


def test_a_part_of_the_picture_is_worth_less(rng: np.random.Generator) -> None:
    photo = GREY + 0.02 * rng.normal(size=GREY.shape)
    covered = photo.copy()
    covered[:, :80] = 5.0  # far beyond the kernel
    (_, whole), (_, half) = solve(photo), solve(covered)
    assert np.all(np.diag(half) > np.diag(whole))


@pytest.mark.parametrize("change", [{"robust": False}, {"gain_and_bias": False}])
def test_every_solver(change: dict[str, bool], rng: np.random.Generator) -> None:
    photo = GREY + 0.02 * rng.normal(size=GREY.shape)
    _, usual = solve(photo)
    _, other = solve(photo, solver=replace(SOLVER, **change))
    ratio = np.diag(other) / np.diag(usual)
    assert ratio.min() > 0.2
    assert ratio.max() < 5.0


def test_curvature_is_the_slope_of_the_influence() -> None:
    residuals, sigma, step = np.linspace(-0.1, 0.1, 201, dtype=np.float32), 0.02, np.float32(1e-4)

    def influence(r: NDArray[np.float32]) -> NDArray[np.float32]:
        return r * tukey_weights(r, sigma)

    slope = (influence(residuals + step) - influence(residuals - step)) / (2 * step)
    np.testing.assert_allclose(tukey_curvature(residuals, sigma), slope, atol=5e-3)
