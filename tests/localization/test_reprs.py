# SPDX-License-Identifier: Apache-2.0
"""What is printed is short, and a notebook's view of a result is whole and escaped."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from helpers import random_pose, simple_camera, some_map
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import (
    LocalizationResult,
    Localizer,
    Matches,
    Photo,
    PosePrior,
    Query,
    RenderedView,
    Start,
)
from gscpe.arrays import short_repr
from gscpe.geometry import se3
from gscpe.localization import Attempt
from gscpe.scene import MapFrame

CAMERA = room_camera(240, 180)
TRUTH = np.asarray(se3.exp([0.06, -0.03, 0.05, 0.02, -0.03, 0.01]) @ ROOM_POSE)


@pytest.fixture(scope="module")
def result() -> LocalizationResult:
    with Localizer(room_map()) as localizer:
        return localizer.localize(room().shoot(CAMERA, TRUTH, samples=2).uint8, CAMERA)


class Cells(HTMLParser):
    """The text of the cells of a table, and whether all tags are closed."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)
        if tag in ("th", "td"):
            self.cells.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.cells[-1] += data


def test_all_that_holds_arrays_prints_a_few_lines(
    rng: np.random.Generator, result: LocalizationResult
) -> None:
    map_ = some_map(rng, count=500, references=60)
    camera, pose = simple_camera(), random_pose(rng)
    image = np.zeros((48, 64), np.float32)
    view = RenderedView(np.zeros((48, 64, 3), np.float32), image, image, image, camera, pose)
    shown = [
        *(map_, map_.scene, map_.references, map_.descriptors, view),
        *(result, result.best, result.coarse, result.aligned),
        *(Start("prior", pose), PosePrior(pose), Query("a.jpg", camera)),
        Photo(np.zeros((48, 64, 3), np.uint8), camera),
        Matches(np.zeros((9, 2)), np.zeros((9, 2)), np.zeros(9, np.float32)),
    ]
    for each in shown:
        assert 0 < len(repr(each)) < 600, repr(each)
        assert repr(each).count("\n") < 8
    assert "500 Gaussians" in repr(map_) and "60 reference photos" in repr(map_)
    assert "1 unit = 1 m" in repr(map_)
    assert "of unknown length" in repr(replace(map_, frame=MapFrame(metres_per_unit=None)))
    assert "depth none" in repr(view)
    assert "inlier_pixels=<float64 " in repr(result.coarse)


def test_a_result_says_pose_and_deviations(result: LocalizationResult) -> None:
    assert result.covariance is not None
    largest = np.sqrt(np.diag(result.covariance))
    text = repr(result)
    assert text.startswith("LocalizationResult: localized\n")
    assert f"{largest[0]:.2g} {largest[1]:.2g} {largest[2]:.2g} m, " in text
    assert f"{np.degrees(largest[5]):.2g} degrees" in text
    assert result.reference is not None and result.reference in text


def test_deviations_are_in_metres_where_the_unit_is_known(result: LocalizationResult) -> None:
    assert result.covariance is not None
    first = np.sqrt(result.covariance[0, 0])
    for metres, text in ((1.0, "m"), (0.01, "m"), (None, "world units")):
        shown = repr(replace(result, metres_per_unit=metres))
        (line,) = [line for line in shown.splitlines() if "standard deviations" in line]
        assert f"deviations: {(metres or 1.0) * first:.2g} " in line
        assert f" {text}, " in line


def test_a_refused_photo_says_why_and_is_escaped() -> None:
    start = Start("reference", np.eye(4), "<b>&.jpg")
    attempt = Attempt(start, None, None, "only 3 < 20 matches & <script>")
    refused = LocalizationResult(
        False, attempt.doubt, None, None, CAMERA, attempt, (attempt,), {"total": 0.5}
    )
    assert "not localized" in repr(refused) and "3 < 20" in repr(refused)
    page = refused._repr_html_()
    assert "<script>" not in page and "<b>" not in page
    cells = Cells(page)
    assert not cells.open
    rows = dict(zip(cells.cells[::2], cells.cells[1::2], strict=True))
    assert rows["status"] == "not localized"
    assert rows["reason"] == "only 3 < 20 matches & <script>"
    assert rows["began at"] == "reference <b>&.jpg"


def test_a_localized_photo_has_the_same_in_a_notebook(result: LocalizationResult) -> None:
    cells = Cells(result._repr_html_())
    rows = dict(zip(cells.cells[::2], cells.cells[1::2], strict=True))
    assert rows["status"] == "localized"
    assert "reason" not in rows
    assert result.cam_from_world is not None
    numbers = [float(word) for word in rows["qw qx qy qz tx ty tz"].split()]
    shown = se3.from_quaternion_translation(numbers[:4], numbers[4:])
    np.testing.assert_allclose(shown, result.cam_from_world, atol=2e-6)


def test_short_repr_of_nested_and_long_values() -> None:
    query = Query("n" * 100, simple_camera())
    assert short_repr(query).startswith("Query(name=<str of 100>, camera=Camera(")
