"""The information matrix: right side, right size, right scale.

NEES is the squared error in units of the covariance; its mean is 6 when six numbers are
estimated with an honest covariance.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers import numeric_jacobian
from numpy.typing import NDArray
from scenes import ROOM_POSE, Shot, World, away_from_creases, room, room_camera

from gscpe.geometry import se3
from gscpe.refinement import LucasKanadeSettings
from gscpe.refinement.lucas_kanade import Alignment, Template, align, build_template, warp
from gscpe.refinement.pyramid import AnchorLevel, ImageLevel
from gscpe.refinement.sampling import sample_bilinear
from gscpe.scene import luminance

CAMERA = room_camera(160, 120)
ROOM = room()
SETTINGS = LucasKanadeSettings()
ASIDE = np.array([0.03, -0.02, 0.04, 0.01, -0.02, 0.015])
ROLLED = np.array([0.3, -0.1, 0.1, 0.02, -0.1, 1.3])


def grey(shot: Shot) -> NDArray[np.float32]:
    return luminance(shot.rgb.astype(np.float32))


def template(world: World) -> Template:
    shot = world.shoot(CAMERA, ROOM_POSE)
    level = AnchorLevel(grey(shot), away_from_creases(shot), CAMERA, shot.depth)
    built = build_template(level, SETTINGS)
    assert built is not None
    return built


def photo_level(image: NDArray[np.floating]) -> ImageLevel:
    return ImageLevel(image.astype(np.float32), np.ones(image.shape, bool), CAMERA)


def photo_from(step: NDArray[np.float64], world: World) -> NDArray[np.float32]:
    return grey(world.shoot(CAMERA, se3.exp(step) @ ROOM_POSE))


def solve(anchor: Template, photo: NDArray[np.floating], step: NDArray[np.float64]) -> Alignment:
    found = align(anchor, photo_level(photo), se3.exp(step), 1.0, 0.0, SETTINGS)
    assert found is not None
    return found


@pytest.mark.parametrize("step", [np.zeros(6), ASIDE, ROLLED], ids=["same pose", "aside", "rolled"])
def test_normalized_error_of_white_noise(step: NDArray[np.float64]) -> None:
    """Measured: 5.0 at the same pose; up to 10 elsewhere, because interpolating the photo
    halves the noise that is seen, but not the noise that moves the pose."""
    rng = np.random.default_rng(3)
    anchor, photo = template(ROOM), photo_from(step, ROOM)
    nees = []
    for _ in range(40):
        found = solve(anchor, photo + 0.03 * rng.normal(size=photo.shape), step)
        # exp(xi) @ estimate = truth
        xi = se3.log(se3.exp(step) @ se3.inverse(found.photo_from_anchor))
        nees.append(xi @ found.information @ xi)
    assert 3.0 < np.mean(nees) < 12.0


def test_it_is_of_a_step_on_the_photos_side() -> None:
    """Against numeric derivatives by xi of ``exp(xi) @ photo_from_anchor``.

    The photo is rolled by 75 degrees, so that the anchor's side has other axes; and taken
    from the same place, where the anchor's Jacobian is exact at any turn.
    """
    world, turned = room(0, 3.0), np.where(np.arange(6) < 3, 0.0, ROLLED)
    anchor, photo = template(world), photo_level(photo_from(turned, world))
    found = solve(anchor, photo.image, turned)
    pose = found.photo_from_anchor

    def intensities(xi: NDArray[np.float64]) -> NDArray[np.float64]:
        u, v, _ = warp(anchor.points, se3.exp(xi) @ pose, photo.camera)
        values, inside = sample_bilinear(photo.image, photo.valid, u, v)
        return np.where(inside, values, 0.0).astype(np.float64)

    u, v, _ = warp(anchor.points, pose, photo.camera)
    margin = 3.0
    inner = (u > margin) & (v > margin) & (u < CAMERA.width - margin) & (v < CAMERA.height - margin)
    jacobian = numeric_jacobian(intensities, np.zeros(6), step=2e-3)[inner]
    light = np.stack([anchor.intensities[inner], np.ones(inner.sum())], axis=1)
    light = light.astype(np.float64)
    # Marginal over gain and bias: what they can explain is taken away.
    jacobian = jacobian - light @ np.linalg.lstsq(light, jacobian, rcond=None)[0]
    expected = jacobian.T @ jacobian / found.residual**2

    ratios = relative_eigenvalues(found.information, expected)
    assert ratios.min() > 0.8
    assert ratios.max() < 1.25
    back = se3.adjoint(pose)
    other_side = relative_eigenvalues(back.T @ found.information @ back, expected)
    assert other_side.max() > 2.0  # the two sides can be told apart here


def relative_eigenvalues(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of b^-1 a: by how much a says more than b, direction by direction."""
    root = np.linalg.inv(np.linalg.cholesky(b))
    return np.asarray(np.linalg.eigvalsh(root @ a @ root.T))


def test_noise_is_estimated_from_the_residual(rng: np.random.Generator) -> None:
    anchor, photo = template(ROOM), photo_from(np.zeros(6), ROOM)
    quiet, loud = (
        solve(anchor, photo + sigma * rng.normal(size=photo.shape), np.zeros(6))
        for sigma in (0.02, 0.04)
    )
    assert quiet.residual == pytest.approx(0.02, rel=0.1)
    assert loud.residual == pytest.approx(0.04, rel=0.1)
    ratio = np.trace(quiet.information) / np.trace(loud.information)
    assert ratio == pytest.approx(4.0, rel=0.1)


def test_it_is_symmetric_and_positive(rng: np.random.Generator) -> None:
    photo = photo_from(ASIDE, ROOM)
    photo += 0.02 * rng.normal(size=photo.shape).astype(np.float32)
    information = solve(template(ROOM), photo, ASIDE).information
    np.testing.assert_allclose(information, information.T, rtol=1e-4)  # float32 sums
    assert np.linalg.eigvalsh(information).min() > 0
