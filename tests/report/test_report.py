# SPDX-License-Identifier: Apache-2.0
"""The report of a run: all numbers, no network, harmless names, and true pictures."""

from __future__ import annotations

import base64
import hashlib
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, Iterator

import cv2
import numpy as np
import pytest
from helpers import random_pose, random_rotation
from markupsafe import Markup
from numpy.typing import NDArray
from report_runs import EVIL, TRUTH, room_run
from scenes import room_map
from scipy.spatial.transform import Rotation

from gscpe import Localizer
from gscpe.errors import OutputError, SettingsError
from gscpe.evaluation import SceneRun
from gscpe.geometry import pose_difference, se3
from gscpe.geometry.pose_error import PoseDifference
from gscpe.matching import SiftMatcher
from gscpe.poses.hloc import format_pose, parse_pose
from gscpe.report import ReportSettings, write_report
from gscpe.report.curves import cumulative_curves
from gscpe.report.ground import choose_ground_plane
from gscpe.report.query_pictures import draw_query
from gscpe.report.selection import select_queries
from gscpe.report.svg import element, log_axis, round_down, round_up

VOID = {"meta", "img", "input", "br", "link", "hr"}
MATCHER = SiftMatcher()


class Page(HTMLParser):
    """A page's elements, text and ids; fails where tags do not balance."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.source, self.open, self.elements = text, ["document"], []
        self.texts: list[str] = []
        self.inside: dict[str, str] = {}
        self.feed(text)
        self.close()
        assert self.open == ["document"], f"never closed: {self.open[1:]}"
        self.text = " ".join(self.texts)
        self.ids = [a["id"] for _, a in self.elements if a.get("id")]

    elements: list[tuple[str, dict[str, str | None]]]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes something else"

    def handle_data(self, data: str) -> None:
        if self.open[-1] in ("script", "style"):
            self.inside[self.open[-1]] = data
        else:
            self.texts.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def localizer() -> Iterator[Localizer]:
    with Localizer(room_map(), matcher=MATCHER) as localizer:
        yield localizer


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def run(localizer: Localizer, folder: Path) -> SceneRun:
    run = room_run(localizer, folder)
    statuses = [detail["status"] for detail in run.details]
    assert statuses == ["localized"] * 4 + ["not localized", "failed"]
    return run


def report(run: SceneRun, localizer: Localizer, folder: Path, **settings: Any) -> Page:
    path = folder / "new" / "report.html"
    write_report(path, run, localizer, folder, ReportSettings(**settings), MATCHER)
    return Page(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def page(run: SceneRun, localizer: Localizer, folder: Path) -> Page:
    return report(run, localizer, folder, date="1 May 2030")


def test_the_page_is_whole(page: Page) -> None:
    assert page.source.startswith("<!DOCTYPE html>")
    assert len(set(page.ids)) == len(page.ids)
    for link in page.all("a"):
        assert link["href"] is not None
        assert link["href"][1:] in page.ids
    for image in page.all("img"):
        assert image.get("src", "data:image/webp").startswith("data:image/webp")  # type: ignore
        assert "alt" in image
    assert len(page.all("article")) == 6


def test_the_page_holds_every_number(page: Page, run: SceneRun) -> None:
    distances, degrees = [], []
    for detail in run.details[:4]:
        truth = run.truths[TRUTH][detail["name"]]
        for stage in (detail, detail["coarse"]):
            error = pose_difference(parse_pose(stage["cam_from_world"]), truth)
            assert f"{100 * error.distance:.2f}" in page.texts
            assert f"{error.degrees:.3f}" in page.texts
        final = pose_difference(parse_pose(detail["cam_from_world"]), truth)
        distances.append(final.distance)
        degrees.append(final.degrees)
        assert f"{detail['coarse']['inliers']}" in page.texts
        assert f"{detail['aligned']['agreement']:.2f}" in page.texts
        assert f"{detail['seconds']['total']:.2f}" in page.texts
        assert detail["name"] in page.texts
    assert f"{100 * np.median(distances):.3g} cm" in page.texts
    assert f"{np.median(degrees):.3g}°" in page.texts
    assert f"{100 * np.median(distances):.3f} / {np.median(degrees):.3f}" in page.texts
    assert "1 of 5" in page.texts  # the black photo has a true pose, the missing one none
    assert "80.0%" in page.texts
    assert "4 / 6" in page.texts
    for text in ("Rooms & co", "the <test> one", "1 May 2030", run.details[4]["reason"]):
        assert text in page.text


def test_nothing_is_loaded_and_nothing_else_runs(page: Page) -> None:
    assert not re.search(r"https?://|@import|url\(", page.source)
    (policy,) = [m["content"] for m in page.all("meta") if "http-equiv" in m]
    assert policy is not None
    assert policy.startswith("default-src 'none'; ")
    for kind, text in page.inside.items():
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in policy
    assert not [a for _, attributes in page.elements for a in attributes if a.startswith("on")]
    assert not [a for _, attributes in page.elements if (a := attributes.get("style"))]


def test_names_are_only_text(page: Page) -> None:
    assert EVIL in page.text
    assert len(page.all("script")) == 1
    assert "<script>alert" not in page.source


def test_a_page_keeps_to_its_size(run: SceneRun, localizer: Localizer, folder: Path) -> None:
    large = len(report(run, localizer, folder, quality=100).source)
    limit = large // 2
    assert len(report(run, localizer, folder, quality=100, max_bytes=limit).source) <= limit


def test_without_a_truth(run: SceneRun, localizer: Localizer, folder: Path) -> None:
    page = report(replace(run, truths={}), localizer, folder, queries=5, worst=1, slowest=0)
    assert "No ground truth is known" in page.text
    assert "position error" not in page.text.split("Position error:")[0]
    assert "least agreement with the map" in page.text
    other = replace(run, truths={"other": {"elsewhere.png": np.eye(4)}})
    assert "has none of these photos" in report(other, localizer, folder, queries=0).text


def test_nothing_was_localized(run: SceneRun, localizer: Localizer, folder: Path) -> None:
    page = report(replace(run, details=run.details[4:]), localizer, folder)
    assert "0 / 2" in page.text
    assert "1 of 1" in page.text
    assert "There is no position error to draw" in page.text
    assert "No pose was found" in page.text
    empty = replace(run, details=(), truths={})
    assert "0 / 0" in report(empty, localizer, folder).text


def test_three_poses_and_their_uncertainty(page: Page, run: SceneRun) -> None:
    for stage in ("coarse", "aligned", "final"):
        assert any(text.startswith(f"{stage}: median ") for text in page.texts)
        assert f"{stage}, error" in page.texts
    assert {"coarse pose", "final pose", "true pose"} <= {*page.texts}
    assert "efined" not in page.text
    for detail in run.details[:4]:
        sigma = 100 * np.sqrt(np.trace(np.array(detail["covariance"])[:3, :3]))
        assert f"{sigma:.2f}" in page.texts


def test_an_unknown_unit(run: SceneRun, localizer: Localizer, folder: Path) -> None:
    page = report(replace(run, metres_per_unit=None), localizer, folder, queries=0)
    assert "final position, units" in page.texts
    assert not re.search(r"\d c?m\b", page.text)
    assert "(cm)" not in page.text


def test_what_cannot_be_written(run: SceneRun, localizer: Localizer, folder: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        write_report(folder, run, localizer, folder, ReportSettings(queries=0))


@pytest.mark.parametrize(
    "wrong", [{"queries": -1}, {"quality": 0}, {"picture_width": 1}, {"boost": 0.0}, {"marks": 0}]
)
def test_settings_out_of_range(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError):
        ReportSettings(**wrong)


def test_pictures_of_a_query(run: SceneRun, localizer: Localizer, folder: Path) -> None:
    detail, settings = run.details[1], ReportSettings(picture_width=120)
    right = draw_query(detail, localizer, MATCHER, folder, settings)
    shapes = {kind: picture.shape for kind, picture in right.pictures.items()}
    assert shapes.pop("matches") == (90, 240, 3)
    assert set(shapes) == {"photo", "render", "difference", "mask", "depth"}
    assert set(shapes.values()) == {(90, 120, 3)}
    assert right.matches is not None
    assert right.inliers is not None
    assert right.inliers > 0.7 * right.matches > 20
    photo, render = (right.pictures[kind].astype(float) for kind in ("photo", "render"))
    assert np.median(np.abs(photo - render)) < 8

    pose = se3.exp([0.15, 0, 0, 0, 0, 0]) @ parse_pose(detail["cam_from_world"])
    off = draw_query(
        dict(detail) | {"cam_from_world": format_pose(pose)}, localizer, MATCHER, folder, settings
    )
    assert off.inliers is not None
    assert off.inliers < 0.2 * right.inliers
    assert off.pictures["difference"].mean() > 2 * right.pictures["difference"].mean()


def test_a_pose_that_is_not_trusted(run: SceneRun, localizer: Localizer, folder: Path) -> None:
    doubted = dict(run.details[0]) | {
        "status": "not localized", "reason": "too <dark>", "cam_from_world": None,
    }  # fmt: skip
    page = report(replace(run, details=(doubted,)), localizer, folder)
    assert "render, not trusted" in page.texts
    assert "too <dark>" in page.text
    alts = [image["alt"] for image in page.all("img")]
    assert any(alt and "not trusted" in alt for alt in alts)


def test_a_photo_that_is_gone(run: SceneRun, localizer: Localizer, tmp_path: Path) -> None:
    page = report(replace(run, details=run.details[:1]), localizer, tmp_path)
    assert "There is no picture: photo" in page.text


def detail_of(name: str, seconds: float, status: str = "localized") -> dict[str, Any]:
    return {"name": name, "status": status, "seconds": {"total": seconds}, "aligned": None}


def test_the_worst_and_the_slowest_are_shown(rng: np.random.Generator) -> None:
    details = [detail_of(f"{i}", float(seconds)) for i, seconds in enumerate(rng.permutation(100))]
    for index in (7, 40, 90):
        details[index]["status"] = "not localized"
    errors = {
        f"{i}": PoseDifference(float(distance), float(degrees))
        for i, (distance, degrees) in enumerate(rng.permutation(200).reshape(100, 2))
        if details[i]["status"] == "localized"
    }
    settings = ReportSettings(queries=12, refused=2, worst=4, slowest=3)
    shown = select_queries(details, errors, True, settings)
    assert len(shown) == len({item.index for item in shown}) == 12
    kinds = {kind: {i.index for i in shown if kind in i.kinds} for kind in ("worst", "slowest")}
    by_distance = sorted(errors, key=lambda name: -errors[name].distance)
    by_degrees = sorted(errors, key=lambda name: -errors[name].degrees)
    assert kinds["worst"] == {int(n) for n in (*by_distance[:3], by_degrees[0])}
    slowest = sorted(range(100), key=lambda i: -details[i]["seconds"]["total"])
    assert kinds["slowest"] == set(slowest[:3])
    assert [item.index for item in shown if "refused" in item.kinds] == [7, 90]
    ordinary = [item.index for item in shown if item.kinds == ("ordinary",)]
    assert np.max(np.diff(ordinary)) < 60
    assert all(len(item.kinds) == len(item.why) for item in shown)


@pytest.mark.parametrize("headings", [360.0, 0.0])
def test_up_is_found_whatever_the_world(headings: float, rng: np.random.Generator) -> None:
    """Cameras held level, pitched by up to 40 degrees downwards, in a turned world."""
    world = random_rotation(rng)
    poses = []
    for _ in range(40):
        yaw, pitch = rng.uniform(0, headings), rng.uniform(10, 40)
        rotation = Rotation.from_euler("YX", [yaw, -pitch], degrees=True).inv().as_matrix()
        poses.append(se3.from_rotation_translation(rotation @ world, rng.normal(size=3)))
    own_up = -np.stack([pose[1, :3] for pose in poses])
    up = -world[1] if headings else own_up.mean(axis=0) / np.linalg.norm(own_up.mean(axis=0))
    plane = choose_ground_plane(np.stack(poses), rng.normal(size=(40, 3)))
    assert plane.up @ up > np.cos(np.radians(3.0))
    axes = np.stack([*plane.axes, plane.up])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(np.cross(*plane.axes), plane.up, atol=1e-9)


def test_without_a_common_up_the_positions_decide(rng: np.random.Generator) -> None:
    poses = np.stack([random_pose(rng) for _ in range(200)])
    centres = rng.normal(size=(200, 3)) * (1.0, 0.1, 5.0)
    plane = choose_ground_plane(poses, centres)
    assert "no common up" in plane.why
    assert abs(plane.up[1]) > 0.99
    assert abs(plane.axes[0, 2]) > 0.99
    assert "no common up" in choose_ground_plane(np.zeros((0, 4, 4)), centres).why
    alone = choose_ground_plane(np.eye(4)[None], np.zeros((1, 3)))
    np.testing.assert_allclose(alone.axes @ alone.up, 0.0, atol=1e-12)


def test_round_numbers_and_ticks() -> None:
    for value in (1.0, 1.7, 2.0, 4.9, 5.0, 9.99, 0.0031, 730.0):
        assert round_down(value) <= value * (1 + 1e-9)
        assert round_up(value) >= value * (1 - 1e-9)
        assert round_up(value) / round_down(value) <= 2.5 * (1 + 1e-9)
    axis = log_axis(np.array([0.03, 0.2, 1.4]), 10.0, 110.0)
    np.testing.assert_allclose(axis.ticks(), [0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0])
    np.testing.assert_allclose(
        axis.at(np.array([0.001, 0.02, 0.2, 2.0, 9.0])), [10, 10, 60, 110, 110]
    )


def test_a_curve_ends_at_the_share_that_was_localized() -> None:
    errors = np.geomspace(1.0, 100.0, 10)
    curves = cumulative_curves("position error", "cm", {"final": list(errors)}, 20)
    svg = curves.drawing
    (path,) = re.findall(r'd="([^"]+)" class="curve final"', svg)
    heights = [float(y) for y in re.findall(r"V([\d.]+)", path)]
    (bottom,) = re.findall(r"^M\S+ (\S+?)H", path)
    grid = [float(y) for y in re.findall(r'd="M[\d.]+ ([\d.]+)H[^"]*" class="grid"', svg)]
    zero, half = float(bottom), grid[2]
    np.testing.assert_allclose(heights, np.linspace(zero, half, 11)[1:], atol=0.06)
    assert curves.legend == {"final": f"final: median {np.median(errors):.3g} cm"}
    assert curves.legend["final"] in svg
    many = cumulative_curves("e", "cm", {"final": list(np.geomspace(1, 9, 5000))}, 5000)
    assert len(many.drawing) < 20_000


def test_only_markup_is_not_escaped() -> None:
    inner = element("text", "1 < 2 & 3", href='"')
    assert inner == '<text href="&#34;">1 &lt; 2 &amp; 3</text>'
    assert element("g", inner, "<", class_="a", text_anchor="end", x=0.504, y=20.0) == (
        f'<g class="a" text-anchor="end" x="0.5" y="20">{inner}&lt;</g>'
    )
    assert isinstance(inner, Markup)


def test_pictures_survive_their_encoding(page: Page, run: SceneRun, folder: Path) -> None:
    """The photo in the page is the photo on the disk, in RGB and not in BGR."""
    first = next(i for i in page.all("img") if i["alt"] == "Photo photo-0.png")
    assert first["src"] is not None
    data = np.frombuffer(base64.b64decode(first["src"].split(",")[1]), np.uint8)
    shown: NDArray[np.uint8] = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
    photo = cv2.imread(str(folder / "photo-0.png"))
    assert photo is not None
    assert (first["width"], first["height"]) == ("240", "180")
    assert np.mean(np.abs(shown.astype(float) - photo)) < 6
