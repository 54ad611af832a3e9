# SPDX-License-Identifier: Apache-2.0
"""The loss and its gradients against float64 NumPy, differences and scikit-image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import simple_camera
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from skimage.metrics import structural_similarity

from gscpe.render import RenderedView
from gscpe.render.kernel_threads import KernelThreads

pytest.importorskip("numba")

from gscpe.training.loss import Loss, photo_loss

HEIGHT, WIDTH, WEIGHT = 21, 26, 0.2
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    rgb: Array
    opacity: Array
    photo: NDArray[np.uint8]
    valid: NDArray[np.bool_] | None
    background: Array
    log_gain: Array
    bias: Array

    def ours(self, threads: int = 1) -> Loss:
        nothing = np.zeros((HEIGHT, WIDTH), dtype=np.float32)
        view = RenderedView(
            self.rgb.astype(np.float32), self.opacity.astype(np.float32), nothing, nothing,
            simple_camera(WIDTH, HEIGHT), np.eye(4),
        )  # fmt: skip
        return photo_loss(
            KernelThreads(threads), view, self.photo, self.valid,
            self.background.astype(np.float32), self.log_gain, self.bias, WEIGHT,
        )  # fmt: skip

    def images(self) -> tuple[Array, Array]:
        over = self.rgb + (1.0 - self.opacity)[:, :, None] * self.background
        x, y = np.exp(self.log_gain) * over + self.bias, self.photo / 255.0
        keep = 1.0 if self.valid is None else self.valid[:, :, None]
        return x * keep, y * keep

    def value(self) -> float:
        x, y = self.images()
        share = 1.0 if self.valid is None else float(self.valid.mean())
        l1 = np.abs(x - y).mean() / share
        return float(l1 + WEIGHT * (1.0 - similarity(x, y)).mean() / share)


def similarity(x: Array, y: Array) -> Array:
    """SSIM, (H, W, 3), from its definition, zeros beyond the borders."""
    window = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window /= window.sum()

    def blur(image: Array) -> Array:
        for axis in (0, 1):
            image = correlate1d(image, window, axis=axis, mode="constant")
        return image

    mx, my = blur(x), blur(y)
    vx, vy, cov = blur(x * x) - mx**2, blur(y * y) - my**2, blur(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    above = (2 * mx * my + c1) * (2 * cov + c2)
    return np.asarray(above / ((mx**2 + my**2 + c1) * (vx + vy + c2)))


def some_case(rng: np.random.Generator, masked: bool) -> Case:
    return Case(
        rgb=rng.uniform(0.0, 1.0, (HEIGHT, WIDTH, 3)),
        opacity=rng.uniform(0.3, 1.0, (HEIGHT, WIDTH)),
        photo=rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8),
        valid=rng.uniform(size=(HEIGHT, WIDTH)) > 0.3 if masked else None,
        background=rng.uniform(size=3),
        log_gain=rng.normal(0.0, 0.2, 3),
        bias=rng.normal(0.0, 0.1, 3),
    )


@pytest.mark.parametrize("masked", [False, True])
def test_value_and_gradients(rng: np.random.Generator, masked: bool) -> None:
    case = some_case(rng, masked)
    ours = case.ours()
    assert ours.value == pytest.approx(case.value(), rel=1e-5)
    for name, found in (
        ("rgb", ours.rgb_gradient),
        ("opacity", ours.opacity_gradient),
        ("log_gain", ours.log_gain_gradient),
        ("bias", ours.bias_gradient),
    ):
        array = getattr(case, name)
        numeric = np.zeros_like(array)
        for index in np.ndindex(array.shape):
            if array.size > 50 and rng.uniform() > 0.1:
                numeric[index] = found[index]  # a tenth is enough
                continue
            ends = []
            for step in (1e-6, -1e-6):
                moved = array.copy()
                moved[index] += step
                ends.append(replace(case, **{name: moved}).value())
            numeric[index] = (ends[0] - ends[1]) / 2e-6
        np.testing.assert_allclose(found, numeric, atol=2e-4 * np.abs(numeric).max(), err_msg=name)


def test_similarity_is_that_of_scikit_image(rng: np.random.Generator) -> None:
    case = some_case(rng, masked=False)
    x, y = case.images()
    _, theirs = structural_similarity(
        x, y, data_range=1.0, channel_axis=2, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    inside = np.s_[5:-5, 5:-5]  # they continue the image beyond its borders
    np.testing.assert_allclose(similarity(x, y)[inside], theirs[inside], atol=1e-6)
    assert case.ours().ssim == pytest.approx(float(similarity(x, y).mean()), abs=1e-5)
    assert case.ours().squared == pytest.approx(float(np.mean((x - y) ** 2)), rel=1e-5)


def test_the_number_of_threads_changes_no_bit(rng: np.random.Generator) -> None:
    case = some_case(rng, masked=True)
    alone, many = case.ours(), case.ours(threads=3)
    assert alone.value == many.value
    np.testing.assert_array_equal(alone.rgb_gradient, many.rgb_gradient)
    np.testing.assert_array_equal(alone.log_gain_gradient, many.log_gain_gradient)


def test_a_photo_of_which_nothing_counts(rng: np.random.Generator) -> None:
    case = replace(some_case(rng, True), valid=np.zeros((HEIGHT, WIDTH), dtype=np.bool_))
    ours = case.ours()
    assert np.isfinite(ours.value)
    assert not np.any(ours.rgb_gradient)
