# SPDX-License-Identifier: Apache-2.0
"""Adam, exposures, densification and schedule, one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import random_scene, simple_camera
from numpy.typing import NDArray

from gscpe.errors import SettingsError
from gscpe.render.kernel_threads import KernelThreads
from gscpe.splats import GaussianScene

pytest.importorskip("numba")

from gscpe.training import backward_projection as layout
from gscpe.training.adam import CORRECTIONS, update_gaussians
from gscpe.training.densification import is_kept, split, to_split
from gscpe.training.exposure import Exposures
from gscpe.training.parameters import MOMENTS, Parameters, sigmoid
from gscpe.training.rasterizer import TrainingRasterizer
from gscpe.training.schedule import Schedule
from gscpe.training.settings import TrainingSettings


def parameters_of(scene: GaussianScene) -> Parameters:
    opacities = scene.opacities.astype(np.float64)
    return Parameters.new(
        scene.means.copy(),
        np.log(scene.scales),
        scene.quaternions.copy(),
        np.log(opacities / (1 - opacities)).astype(np.float32),
        scene.sh.copy(),
    )


def some_parameters(rng: np.random.Generator, count: int = 40, degree: int = 1) -> Parameters:
    return parameters_of(random_scene(rng, count, degree))


def random_gradients(rng: np.random.Generator, count: int) -> NDArray[np.float32]:
    gradients = rng.normal(size=(count, layout.GRADIENT)).astype(np.float32)
    direction = gradients[:, layout.DIRECTION : layout.DIRECTION + 3]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return gradients


def update(
    parameters: Parameters,
    gradients: NDArray[np.float32],
    rates: NDArray[np.float32],
    harmonics_rate: float = 0.0,
    pulls: tuple[float, float] = (0.0, 0.0),
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    count = len(parameters)
    lengths, seen = np.zeros(count, dtype=np.float32), np.zeros(count, dtype=np.int32)
    p = parameters
    update_gaussians(
        0, count, np.arange(count, dtype=np.uint64), gradients, rates, np.float32(harmonics_rate),
        np.float32(pulls[0]), np.float32(pulls[1]), np.float32(10.0), CORRECTIONS, p.means,
        p.log_scales, p.scales, p.quaternions, p.logits, p.opacities, p.sh, p.first, p.second,
        p.steps, lengths, seen,
    )  # fmt: skip
    return lengths, seen


def test_adam_is_that_of_the_paper(rng: np.random.Generator) -> None:
    """Three steps of every value against Kingma and Ba's Algorithm 1, in float64."""
    p = some_parameters(rng)
    rates = rng.uniform(1e-3, 1e-2, MOMENTS).astype(np.float32)
    expected = [
        np.array(a, dtype=np.float64) for a in (p.means, p.log_scales, p.logits, p.sh[:, 0])
    ]
    first, second = np.zeros((2, len(p), MOMENTS))
    for t in range(1, 4):
        g = random_gradients(rng, len(p))
        whole = np.concatenate([g[:, :11], 0.28209479 * g[:, 11:14]], axis=1).astype(np.float64)
        first = 0.9 * first + 0.1 * whole
        second = 0.999 * second + 0.001 * whole**2
        step = rates * (first / (1 - 0.9**t)) / np.sqrt(second / (1 - 0.999**t))
        for array, columns in zip(
            expected, (slice(0, 3), slice(3, 6), slice(10, 11), slice(11, 14)), strict=True
        ):
            array[...] = array - step[:, columns].reshape(array.shape)
        lengths, seen = update(p, g, rates)
        pixel = g[:, layout.PIXEL : layout.PIXEL + 2]
        np.testing.assert_allclose(lengths, 10 * np.linalg.norm(pixel, axis=1), rtol=1e-5)
        assert np.all(seen == 1)
    for array, ours in zip(expected, (p.means, p.log_scales, p.logits, p.sh[:, 0]), strict=True):
        np.testing.assert_allclose(ours, array, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(p.scales, np.exp(p.log_scales), rtol=1e-5)
    np.testing.assert_allclose(p.opacities, sigmoid(p.logits), rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(p.quaternions, axis=1), 1.0, rtol=1e-5)
    assert np.all(p.steps == 3)


def test_hidden_gaussians_stay_as_they_are(rng: np.random.Generator) -> None:
    p = some_parameters(rng)
    before = p.take(np.arange(len(p)))
    _, seen = update(
        p, np.zeros((len(p), layout.GRADIENT), dtype=np.float32), np.ones(MOMENTS, dtype=np.float32)
    )
    assert not np.any(seen) and not np.any(p.steps)
    np.testing.assert_array_equal(p.means, before.means)
    np.testing.assert_array_equal(p.opacities, before.opacities)


def test_regularization_pulls_opacity_and_scales_down(rng: np.random.Generator) -> None:
    p = some_parameters(rng)
    opacities, scales = p.opacities.copy(), p.scales.copy()
    g = random_gradients(rng, len(p))
    g[:, :14] = 0.0
    update(p, g, np.full(MOMENTS, 1e-2, dtype=np.float32), pulls=(1e-6, 1e-6))
    assert np.all(p.opacities < opacities) and np.all(p.scales < scales)


def test_descent_makes_a_picture_more_alike(rng: np.random.Generator) -> None:
    """Harmonics of all degrees alone, through rasterizer and update: the squared error falls."""
    scene = random_scene(rng, 60, 3, scale=(0.2, 0.5))
    p, camera = parameters_of(scene), simple_camera(32, 24)
    p.sh[:] *= 0.5
    rasterizer = TrainingRasterizer(KernelThreads(1))
    wanted = rasterizer.forward(
        parameters_of(scene).as_rendered(), camera, np.eye(4)
    ).view.rgb.copy()
    errors, rates = [], np.zeros(MOMENTS, dtype=np.float32)
    rates[11:] = 0.01
    nothing = np.zeros((24, 32), dtype=np.float32)
    for _ in range(30):
        forward = rasterizer.forward(p.as_rendered(), camera, np.eye(4))
        off = forward.view.rgb - wanted
        errors.append(float(np.mean(off**2)))
        gradients = rasterizer.backward(p.as_rendered(), forward, off, nothing)
        by_gaussian = np.zeros((len(p), layout.GRADIENT), dtype=np.float32)
        for begin, end in gradients.used:
            by_gaussian[gradients.keys[begin:end] & np.uint64(0xFFFFFFFF)] = gradients.by_slot[
                begin:end
            ]
        update(p, by_gaussian, rates, harmonics_rate=0.002)
    assert errors[-1] < 0.2 * errors[0]


def test_the_mean_exposure_goes_into_the_colours(rng: np.random.Generator) -> None:
    p, camera = some_parameters(rng), simple_camera(32, 24)
    exposures = Exposures.neutral(5)
    exposures.values[:] = rng.normal(0.3, 0.1, exposures.values.shape)
    p.sh[:, 1:] = 0.0
    p.sh[:, 0] = np.abs(p.sh[:, 0])  # no channel is clamped at black
    before = TrainingRasterizer(KernelThreads(1)).forward(p.as_rendered(), camera, np.eye(4)).view
    log_gain, bias = exposures.values.mean(axis=0)
    exposures.fold_mean_into(p)
    after = TrainingRasterizer(KernelThreads(1)).forward(p.as_rendered(), camera, np.eye(4)).view
    expected = np.exp(log_gain) * before.rgb + bias * before.opacity[:, :, None]
    np.testing.assert_allclose(after.rgb, expected, atol=1e-5)
    np.testing.assert_allclose(exposures.values.mean(axis=0), 0.0, atol=1e-12)


def test_split_halves_lie_along_the_longest_axis_and_look_alike(rng: np.random.Generator) -> None:
    p = some_parameters(rng, 30)
    chosen = np.array([3, 17])
    after = split(p, chosen)
    assert len(after) == len(p) + 2
    halves = after.take(np.arange(len(after) - 4, len(after)))
    for n, g in enumerate(chosen):
        a, b = halves.means[n], halves.means[n + 2]
        np.testing.assert_allclose(0.5 * (a + b), p.means[g], atol=1e-5)
        assert np.linalg.norm(a - b) == pytest.approx(p.scales[g].max(), rel=1e-4)
        together = 1 - (1 - halves.opacities[n]) ** 2
        assert p.opacities[g] < together < 1
    kept = np.delete(np.arange(len(p)), chosen)
    np.testing.assert_array_equal(after.means[: len(kept)], p.means[kept])
    assert not np.any(halves.steps) and not np.any(halves.first)


def test_the_budget_is_spent_by_the_last_round_and_never_exceeded() -> None:
    settings = TrainingSettings(max_gaussians=1000, densify_rounds=8, most_growth=0.5)
    count = 300
    for round_ in range(1, 9):
        scores = np.linspace(1.0, 2.0, count).astype(np.float32)
        chosen = to_split(scores, round_, settings)
        assert np.all(scores[chosen] >= np.sort(scores)[-len(chosen)])  # the greatest
        count += len(chosen)
        assert count <= 1000
    assert count >= 990
    assert not len(to_split(np.zeros(300, dtype=np.float32), 1, settings))  # nothing asks for it
    assert not len(to_split(np.ones(1000, dtype=np.float32), 8, settings))


def test_faint_and_large_gaussians_are_dropped(rng: np.random.Generator) -> None:
    p = some_parameters(rng)
    p.opacities[4] = 0.01
    p.scales[7, 1] = 4.0
    assert set(np.flatnonzero(~is_kept(p, 10.0, TrainingSettings()))) == {4, 7}


def test_the_clock_is_kept_where_large_photos_take_longer() -> None:
    """Half photos take 0.1 s, whole ones 0.3 s, and twice as long after a while."""
    schedule = Schedule(TrainingSettings(minutes=2.0))
    seconds, small_seconds, steps = 10.0, 0.0, []
    while not schedule.is_done:
        cost = (0.1 if schedule.is_small else 0.3) * (2.0 if seconds > 60 else 1.0)
        small_seconds += cost * schedule.is_small
        seconds += cost
        before = schedule.share
        schedule.advance(seconds, cost)
        steps.append(schedule.share - before)
    assert 117 < seconds < 120
    assert 0.25 < small_seconds / seconds < 0.5
    assert max(steps) < 0.01  # no leap at the end


def test_by_iterations_the_schedule_is_exact() -> None:
    settings = TrainingSettings(iterations=1000, densify_rounds=10, prune_until=0.9)
    schedule = Schedule(settings)
    for _ in range(1000):
        assert not schedule.is_done
        schedule.advance(0.0, 1.0)
    assert schedule.is_done
    assert [settings.sh_degree_at(share) for share in (0, 0.13, 0.26, 0.4, 1)] == [0, 1, 2, 3, 3]
    assert settings.round_at(0.07) == 0
    assert settings.round_at(settings.densify_until) == 10
    assert settings.round_at(0.9) == settings.round_at(1.0) > 10


@pytest.mark.parametrize(
    "wrong",
    [
        {"iterations": 0},
        {"minutes": -1.0},
        {"minutes": float("nan")},
        {"max_gaussians": 5},
        {"sh_degree": 4},
        {"sh_shares": (0.5, 0.1, 0.2)},
        {"small_share": 1.5},
        {"first_opacity": 1.0},
        {"densify_rounds": 0},
        {"seed": -1},
    ],
)
def test_settings_out_of_range(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        TrainingSettings(**wrong)
