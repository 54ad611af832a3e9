# SPDX-License-Identifier: Apache-2.0
"""Photo, render and difference side by side, and a result as a notebook shows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_map

import gscpe
from gscpe import Localizer, PosePrior
from gscpe.geometry import se3
from gscpe.matching import SiftMatcher
from gscpe.report.comparison import strip_path

CAMERA = room_camera(240, 180)


def test_a_result_is_shown_with_its_pictures() -> None:
    photo = room().shoot(CAMERA, se3.exp([0.02, 0.01, 0, 0, 0.01, 0]) @ ROOM_POSE).uint8
    with Localizer(room_map(), matcher=SiftMatcher()) as localizer:
        result = localizer.localize(photo, CAMERA, PosePrior(ROOM_POSE))
        shown = gscpe.show(result, photo, localizer)
        black = np.zeros_like(photo)
        lost = localizer.localize(black, CAMERA)
        without = gscpe.show(lost, black, localizer)
    html = shown._repr_html_()
    assert "standard deviations" in html
    assert html.count("data:image/webp;base64,") == 1
    assert shown.picture.shape == (206, 720, 3)
    assert np.array_equal(shown.picture[26:, :240], photo)
    assert not lost.localized
    assert str(lost.reason)[:20] in without._repr_html_()
    assert without.picture.shape[0] == 206


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("a.png", "a.png"),
        ("seq/a.jpg", "seq/a.jpg.png"),
        ("../../a.PNG", "a.PNG"),
        ("/etc/a.jpg", "etc/a.jpg.png"),
        ("b\\a.jpg", "b/a.jpg.png"),
    ],
)
def test_pictures_stay_in_their_folder(name: str, path: str) -> None:
    assert strip_path(Path("out"), name) == Path("out") / path
