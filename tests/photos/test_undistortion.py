# SPDX-License-Identifier: Apache-2.0
"""Lens distortion is removed to a fraction of a pixel, in COLMAP's pixel coordinates."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import distorted_projection
from numpy.typing import NDArray

from gscpe.geometry import Camera
from gscpe.geometry.projection import project
from gscpe.photos import to_photo

WIDTH, HEIGHT = 640, 480
FOCAL = (456.0, 427.0, 301.3, 260.2)
CAMERAS = {
    "barrel": Camera(WIDTH, HEIGHT, *FOCAL, (-0.25, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    "pincushion": Camera(WIDTH, HEIGHT, *FOCAL, (0.2, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    "rational": Camera(
        WIDTH, HEIGHT, *FOCAL, (-0.2, 0.03, 0.006, -0.008, 0.01, 0.02, -0.01, 0.005)
    ),
    "fisheye": Camera(
        WIDTH, HEIGHT, *FOCAL, (0.05, -0.03, 0.0, 0.0, 0.01, 0.002, 0.0, 0.0), fisheye=True
    ),
    "thin prism": Camera(
        WIDTH, HEIGHT, *FOCAL, (-0.04, 0.02, 0.006, -0.008, 0.01, 0.0, 0.01, -0.005), fisheye=True
    ),
}
WINDOW = 6


def grid_of_points() -> NDArray[np.float64]:
    """Points one unit away that all three cameras see within the picture."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.42, 0.35, 7))
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)


def draw_blobs(centres: NDArray[np.float64], sigma: float = 1.5) -> NDArray[np.uint8]:
    """White blobs on black; pixel (row i, column j) is sampled at (j + 0.5, i + 0.5)."""
    u, v = np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5
    rows = np.exp(-0.5 * (v - centres[:, 1, None]) ** 2 / sigma**2)
    columns = np.exp(-0.5 * (u - centres[:, 0, None]) ** 2 / sigma**2)
    picture = 250.0 * rows.T @ columns
    return np.rint(np.clip(picture, 0, 255)).astype(np.uint8)


def centroid_near(picture: NDArray[np.uint8], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """The centre of mass of the blob whose centre is about there, COLMAP pixels."""
    j, i = np.floor(at).astype(int)
    rows, columns = np.mgrid[i - WINDOW : i + WINDOW + 1, j - WINDOW : j + WINDOW + 1]
    mass = picture[rows, columns].astype(np.float64)
    weighted = [np.sum(mass * (columns + 0.5)), np.sum(mass * (rows + 0.5))]
    return np.asarray(weighted, dtype=np.float64) / float(mass.sum())


def centroid_errors(picture: NDArray[np.uint8], centres: NDArray[np.float64]) -> float:
    errors = [np.linalg.norm(centroid_near(picture, centre) - centre) for centre in centres]
    return float(np.max(errors))


@pytest.mark.parametrize("name", CAMERAS)
def test_features_land_where_a_pinhole_sees_them(name: str) -> None:
    camera, points = CAMERAS[name], grid_of_points()
    bent, straight = distorted_projection(camera, points), project(camera, points)
    assert np.abs(bent - straight).max() > 4.0  # there is something to undo
    grey = draw_blobs(bent)
    assert centroid_errors(grey, bent) < 0.01  # the measurement itself
    photo = to_photo(np.dstack([grey] * 3), camera)
    assert photo.camera == camera.without_distortion()
    assert centroid_errors(photo.rgb[:, :, 0], straight) < 0.05


@pytest.mark.parametrize("name", CAMERAS)
def test_valid_marks_what_the_photo_did_not_show(name: str) -> None:
    camera = CAMERAS[name]
    photo = to_photo(np.full((HEIGHT, WIDTH, 3), 200, np.uint8), camera)
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=-1)
    rays = np.dstack([rays, np.ones(u.shape)]).reshape(-1, 3)
    source = distorted_projection(camera, rays).reshape(HEIGHT, WIDTH, 2)
    # How far within the outermost pixel centres, give or take the rounding of the map.
    inside = np.minimum(source, [WIDTH, HEIGHT] - source).min(axis=2) - 0.5
    valid = np.ones((HEIGHT, WIDTH), bool) if photo.valid is None else photo.valid
    assert valid.dtype == bool
    assert np.all(valid[inside > 1e-3])
    assert not np.any(valid[inside < -1e-3])
    assert np.all(photo.rgb[valid] == 200)


def test_all_is_valid_under_barrel_distortion() -> None:
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    assert to_photo(picture, CAMERAS["barrel"]).valid is None
    outside = to_photo(picture, CAMERAS["pincushion"]).valid
    assert outside is not None
    assert 0.5 < outside.mean() < 1.0
