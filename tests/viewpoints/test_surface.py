# SPDX-License-Identifier: Apache-2.0
"""Which of a splat's Gaussians views show, and what a certificate makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import furnished_room, splat_of

from gscpe import MapSettings, map_with_virtual_references
from gscpe.geometry import Camera
from gscpe.making import CertificateSettings, certify_virtual
from gscpe.making.certificate import Certificate, CertifiedPhoto
from gscpe.render import Renderer
from gscpe.splats import GaussianScene
from gscpe.viewpoints import Viewpoints, times_seen

CAMERA = Camera.pinhole(160, 120, fx=80.0, fy=80.0, cx=80.0, cy=60.0)


def wall_behind_a_wall() -> GaussianScene:
    """Two opaque walls, 21 x 21 Gaussians each, 2 and 4 before the origin along z."""
    x, y = np.meshgrid(np.linspace(-2, 2, 21), np.linspace(-2, 2, 21))
    wall = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    means = np.concatenate([wall + np.array([0, 0, z]) for z in (2.0, 4.0)])
    count = len(means)
    return GaussianScene(
        means=means.astype(np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (count, 1)),
        scales=np.tile(np.array([0.15, 0.15, 0.01], dtype=np.float32), (count, 1)),
        opacities=np.full(count, 0.95, dtype=np.float32),
        sh=np.zeros((count, 1, 3), dtype=np.float32),
    )


def test_what_is_hidden_or_outside_of_the_picture_is_not_seen() -> None:
    scene = wall_behind_a_wall()
    ahead, back = np.eye(4), np.diag([-1.0, 1.0, -1.0, 1.0])
    with Renderer(scene) as renderer:
        times = times_seen(scene, np.stack([ahead, ahead, back]), (CAMERA,) * 3, renderer)
    front, behind = times[:441], times[441:]
    x, y, z = scene.means[:441].T
    inside = (np.abs(x / z) < 0.99) & (np.abs(y / z) < 0.74)
    outside = np.abs(y / z) > 0.76
    assert np.all(front[inside] == 2)
    assert np.all(front[outside] == 0)
    assert np.all(behind == 0)


def level(yaw: float) -> NDArray[np.float64]:
    """From the middle of the room, at eye height."""
    forward = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(forward, [0, 0, 1.0]), [0, 0, -1.0], forward])
    pose[:3, 3] = -pose[:3, :3] @ [0.0, 0.0, 1.3]
    return pose


def test_a_map_whose_references_look_one_way_shows_little() -> None:
    """Renders from beside its viewpoints may all be localized: that alone would call it good."""
    scene, settings = splat_of(furnished_room()), CertificateSettings(renders=2)
    seen = []
    for yaws in (np.linspace(-0.3, 0.3, 8), 2 * np.pi * np.arange(8) / 8):
        views = Viewpoints(np.stack([level(yaw) for yaw in yaws]), CAMERA, np.eye(3)[2], True)
        map_ = map_with_virtual_references(scene, MapSettings(), views)
        seen.append(certify_virtual(map_, settings, matcher="sift").seen)
    one_way, all_around = seen
    assert one_way is not None and all_around is not None
    assert one_way < 0.6 < all_around


@pytest.mark.parametrize(
    ("seen", "verdict"), [(None, "good"), (0.96, "good"), (0.8, "usable"), (0.4, "poor")]
)
def test_what_is_not_seen_counts(seen: float | None, verdict: str) -> None:
    photo = CertifiedPhoto("a", None, 0.001, 0.01, 20.0, 22.0, 0.7)
    certificate = Certificate(
        (photo,) * 12, 4.0, None, 300, 1000, CertificateSettings(), of_renders=True
    )
    certificate = replace(certificate, seen=seen)
    assert certificate.verdict == verdict
    assert ("of what the splat holds" in certificate.explanation()) == (seen is not None)
