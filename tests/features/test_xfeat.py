# SPDX-License-Identifier: Apache-2.0
"""XFeat features: what is made of the network's maps, and the installed network on a photo."""

from __future__ import annotations

from typing import Any, Mapping

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import gscpe.features.xfeat as module
from gscpe.errors import MissingDependencyError, ModelError, PhotoError, SettingsError
from gscpe.features.xfeat import XFeat, XFeatFeatures
from gscpe.matching.lighterglue import LighterGlue

Float32 = NDArray[np.float32]


class FakeNetwork:
    """Answers with given maps, and keeps the image it was asked about."""

    def __init__(self, keypoints: Float32, reliability: Float32, descriptors: Float32) -> None:
        self.maps = [keypoints, reliability, descriptors]
        self.image = np.zeros((0, 0), dtype=np.float32)

    def run(self, inputs: Mapping[str, Float32]) -> list[Float32]:
        self.image = inputs["image"][0, 0]
        assert self.image.shape == self.maps[0].shape
        return self.maps


@pytest.fixture
def network(rng: np.random.Generator) -> FakeNetwork:
    """For images of up to 96 x 64 pixels, without any keypoint."""
    return FakeNetwork(
        np.zeros((64, 96), dtype=np.float32),
        np.ones((8, 12), dtype=np.float32),
        rng.normal(size=(8, 12, 64)).astype(np.float32),
    )


@pytest.fixture
def xfeat(network: FakeNetwork, monkeypatch: pytest.MonkeyPatch) -> XFeat:
    monkeypatch.setattr(module, "Network", lambda *_: network)
    return XFeat("any.onnx")


IMAGE = np.random.default_rng(3).integers(0, 256, size=(64, 96), dtype=np.uint8)


def test_keypoints_are_centres_of_pixels(xfeat: XFeat, network: FakeNetwork) -> None:
    network.maps[0][5, 9], network.maps[0][40, 70] = 0.5, 0.9
    features = xfeat.detect(IMAGE)
    np.testing.assert_array_equal(features.pixels, [[70.5, 40.5], [9.5, 5.5]])
    np.testing.assert_allclose(features.scores, [0.9, 0.5], rtol=1e-6)
    assert features.pixels.dtype == np.float64
    assert features.descriptors.dtype == features.scores.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(features.descriptors, axis=1), 1.0, rtol=1e-6)


def test_only_the_best_of_a_neighbourhood(xfeat: XFeat, network: FakeNetwork) -> None:
    network.maps[0][20, 30], network.maps[0][22, 32], network.maps[0][20, 36] = 0.5, 0.4, 0.3
    assert len(xfeat.detect(IMAGE)) == 2
    assert len(xfeat.detect(IMAGE, threshold=0.3)) == 1
    np.testing.assert_array_equal(xfeat.detect(IMAGE, 1).pixels, [[30.5, 20.5]])


def test_no_keypoints_outside_the_image_or_where_masked(xfeat: XFeat, network: FakeNetwork) -> None:
    image = IMAGE[:50, :70]
    for row, column in ((48, 68), (50, 60), (40, 70), (10, 10)):
        network.maps[0][row, column] = 0.5
    assert {tuple(pixel) for pixel in xfeat.detect(image).pixels} == {(68.5, 48.5), (10.5, 10.5)}
    np.testing.assert_array_equal(network.image[:50, 70:], network.image[:50, 69:70].repeat(26, 1))
    valid = np.ones(image.shape, dtype=bool)
    valid[48, 68] = False
    np.testing.assert_array_equal(xfeat.detect(image, valid=valid).pixels, [[10.5, 10.5]])
    with pytest.raises(PhotoError, match="mask"):
        xfeat.detect(image, valid=valid[1:])


def test_scores_and_descriptors_are_interpolated(
    xfeat: XFeat, network: FakeNetwork, rng: np.random.Generator
) -> None:
    """OpenCV interpolates alike: bilinear, and cubic with the slope -0.75 (to 1/32 of a pixel;
    so the scale is chosen to meet its steps)."""
    x, y = rng.integers(0, 12 * 32, 40) / 32 - 0.5, rng.integers(0, 8 * 32, 40) / 32 - 0.5
    reliability, descriptors = rng.uniform(size=(8, 12)).astype(np.float32), network.maps[2]
    at = (x.astype(np.float32)[None], y.astype(np.float32)[None])
    expected = cv2.remap(reliability, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)[0]
    np.testing.assert_allclose(module._sample_bilinear(reliability, x, y), expected, atol=1e-6)
    cubic = np.stack(
        [
            cv2.remap(channel, *at, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)[0]
            for channel in descriptors.transpose(2, 0, 1).copy()
        ],
        axis=1,
    )
    cubic /= np.linalg.norm(cubic, axis=1, keepdims=True)
    np.testing.assert_allclose(module._sample_bicubic(descriptors, x, y), cubic, atol=1e-5)


def test_where_descriptors_are_sampled() -> None:
    """As the original: the first pixel's centre at the map's left border, the last one's at its
    right border, evenly between."""
    np.testing.assert_allclose(module._on_map(np.array([0, 95]), 96), [-0.5, 11.5])
    np.testing.assert_allclose(module._on_map(np.array([19, 38]), 96), [1.9, 4.3])


def test_kinds_of_images(xfeat: XFeat, network: FakeNetwork) -> None:
    xfeat.detect(IMAGE)
    expected = network.image.copy()
    np.testing.assert_allclose([expected.mean(), expected.std()], [0, 1], atol=1e-3)
    same: list[NDArray[Any]] = [
        (IMAGE / 255).astype(np.float32),
        np.stack([IMAGE] * 3, axis=2),
        np.stack([IMAGE / 255] * 3, axis=2).astype(np.float32),
    ]
    for image in same:
        xfeat.detect(image)
        np.testing.assert_allclose(network.image, expected, atol=1e-4)
    xfeat.detect(np.full((64, 96), 200, dtype=np.uint8))
    np.testing.assert_allclose(network.image, 0.0, atol=1e-4)
    bad: list[NDArray[Any]] = [
        IMAGE.astype(np.float64),
        IMAGE[:, :, None],
        IMAGE[0],
        IMAGE[:0],
        np.full((64, 96), np.nan, dtype=np.float32),
    ]
    for image in bad:
        with pytest.raises(PhotoError):
            xfeat.detect(image)
    with pytest.raises(SettingsError):
        xfeat.detect(IMAGE, max_features=0)
    for threshold in (1.0, -0.1):
        with pytest.raises(SettingsError):
            xfeat.detect(IMAGE, threshold=threshold)


# From here on, the installed networks.


@pytest.fixture(scope="module")
def real() -> tuple[XFeat, LighterGlue]:
    try:
        return XFeat(threads=1), LighterGlue(threads=1)
    except (ModelError, MissingDependencyError) as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def photo() -> NDArray[np.uint8]:
    from skimage.data import stereo_motorcycle

    return np.ascontiguousarray(stereo_motorcycle()[0][:480, :640])


def positions(features: XFeatFeatures) -> set[tuple[float, float]]:
    return {(float(u), float(v)) for u, v in features.pixels}


def test_a_shifted_image_shifts_its_keypoints(
    real: tuple[XFeat, LighterGlue], photo: NDArray[np.uint8]
) -> None:
    """Exactly, by whole cells of the coarsest level, far from where the border matters."""
    scene = np.zeros((544, 704, 3), dtype=np.uint8)
    moved = scene.copy()
    scene[192:320, 192:384], moved[224:352, 160:352] = (photo[192:320, 192:384],) * 2
    before, after = (real[0].detect(image) for image in (scene, moved))
    expected = {(u - 32, v + 32) for u, v in positions(before)}
    assert len(expected) > 100
    assert positions(after) == expected


def test_pixel_centres_stay_when_upside_down(
    real: tuple[XFeat, LighterGlue], photo: NDArray[np.uint8]
) -> None:
    """v becomes 480 - v. Keypoints half a pixel off would be one pixel off here. (Left and
    right do not serve: the trained network's peaks lean to the right.)"""
    features = real[0].detect(photo)
    other = real[0].detect(np.ascontiguousarray(photo[::-1]))
    back = other.pixels * [1, -1] + [0, 480]
    distance, nearest = cKDTree(back).query(features.pixels)
    offsets = (back[nearest] - features.pixels)[distance < 2.5]
    assert len(offsets) > 500
    assert np.abs(offsets.mean(axis=0)).max() < 0.4


def warped(photo: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """A photo enlarged, turned and in perspective, with the homography between its pixels."""
    homography = np.array([[1.25, 0.12, -90.3], [-0.10, 1.22, -20.6], [8e-5, -5e-5, 1.0]])
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # from OpenCV's pixels
    opencv = np.linalg.inv(half) @ homography @ half
    return np.asarray(cv2.warpPerspective(photo, opencv, (640, 480))), homography


@pytest.mark.parametrize(("matcher", "share"), [("nearest", 0.6), ("lighterglue", 0.8)])
def test_matches_with_a_warped_photo(
    matcher: str, share: float, real: tuple[XFeat, LighterGlue], photo: NDArray[np.uint8]
) -> None:
    xfeat, lighterglue = real
    image, homography = warped(photo)
    a, b = xfeat.detect(photo, 2048), xfeat.detect(image, 2048)
    if matcher == "lighterglue":
        pairs, scores = lighterglue.match(a, (640, 480), b, (640, 480))
        assert scores.min() > 0.1
    else:
        similarity = a.descriptors @ b.descriptors.T
        best = similarity.argmax(axis=1)
        mutual = similarity.argmax(axis=0)[best] == np.arange(len(a))
        kept = np.flatnonzero(mutual & (similarity.max(axis=1) > 0.82))
        pairs = np.stack([kept, best[kept]], axis=1)
    points = np.concatenate([a.pixels[pairs[:, 0]], np.ones((len(pairs), 1))], axis=1)
    there = points @ homography.T
    errors = b.pixels[pairs[:, 1]] - there[:, :2] / there[:, 2:]
    right = np.linalg.norm(errors, axis=1) < 3.0
    assert right.sum() > 200
    assert right.mean() > share
    assert np.median(np.linalg.norm(errors[right], axis=1)) < 1.2
    assert np.abs(errors[right].mean(axis=0)).max() < 0.3


def test_lighterglue_limits(real: tuple[XFeat, LighterGlue], photo: NDArray[np.uint8]) -> None:
    xfeat, lighterglue = real
    features, size = xfeat.detect(photo, 600), (640, 480)
    order = np.random.default_rng(0).permutation(len(features))
    shuffled = XFeatFeatures(
        features.pixels[order], features.scores[order], features.descriptors[order]
    )
    pairs, _ = lighterglue.match(features, size, shuffled, size, max_features=200)
    assert 150 < len(pairs) <= 200
    np.testing.assert_array_equal(pairs[:, 0], order[pairs[:, 1]])  # each found itself
    assert pairs[:, 0].max() < 200  # the best only
    nothing = XFeatFeatures(
        np.zeros((0, 2)), np.zeros(0, np.float32), np.zeros((0, 64), np.float32)
    )
    pairs, scores = lighterglue.match(features, size, nothing, size)
    assert pairs.shape == (0, 2)
    assert scores.shape == (0,)
    with pytest.raises(SettingsError):
        lighterglue.match(features, size, features, size, min_score=1.0)
    with pytest.raises(SettingsError):
        lighterglue.match(features, (0, 480), features, size)
