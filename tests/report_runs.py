# SPDX-License-Identifier: Apache-2.0
"""A small run to report: photos of the ray-cast room, one black, one missing and ill-named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scenes import ROOM_POSE, room, room_camera

from gscpe import Localizer
from gscpe.batch import localize_list
from gscpe.evaluation import SceneRun
from gscpe.geometry import se3
from gscpe.photos import write_image
from gscpe.scene.query_list import Query

CAMERA = room_camera(240, 180)
EVIL = '"><script>alert(1)</script><img src=x onerror=alert(2)>&amp;.png'
TRUTH = "ray-cast"


def room_run(localizer: Localizer, folder: Path) -> SceneRun:
    """Four photos that are localized, "black.png" and EVIL, which are not; photos in
    ``folder``. The truth is off by up to 2 cm, so that errors differ."""
    truth = {}
    for number in range(4):
        step = np.array([0.03 * number, -0.02, 0.02, 0.01, -0.01 * number, 0.0])
        pose = se3.exp(step) @ ROOM_POSE
        name = f"photo-{number}.png"
        write_image(folder / name, room().shoot(CAMERA, pose).uint8)
        truth[name] = se3.exp([0.002 * 2**number, 0, 0, 0, 0.001 * number, 0]) @ pose
    write_image(folder / "black.png", np.zeros((180, 240, 3), np.uint8))
    names = [*truth, "black.png", EVIL]
    details = localize_list(
        localizer, [Query(name, CAMERA) for name in names], folder, folder / "details.jsonl"
    )
    truth["black.png"] = ROOM_POSE
    setup = {"gscpe": "0.0.0", "renderer": "the <test> one"}
    return SceneRun("Rooms & co", "ray-cast room", tuple(details), {TRUTH: truth}, 1.0, setup)
