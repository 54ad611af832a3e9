# SPDX-License-Identifier: Apache-2.0
"""What is shown: which cameras in which frame, how sure they are, and what is said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import random_pose, random_scene, some_map
from numpy.typing import NDArray
from scenes import ROOM_POSE, room_map, scaled_pose

from gscpe.errors import InputError, PoseError, SettingsError
from gscpe.geometry import Camera, se3
from gscpe.geometry.pose_error import camera_centre
from gscpe.geometry.projection import project, transform_points
from gscpe.poses import write_pose_file
from gscpe.poses.hloc import format_pose
from gscpe.poses.tum import format_tum
from gscpe.viewer import Findings, contents_of, read_findings
from gscpe.viewer.cameras import (
    ShownCamera,
    Viewpoint,
    between,
    frustum_corners,
    photo_plane,
    viewpoint_of,
)
from gscpe.viewer.ellipsoids import centre_ellipsoid, sphere_mesh
from gscpe.viewer.photos import Photos
from gscpe.viewer.splat import (
    Section,
    browser_splat,
    browser_unit,
    most_visible,
    scaled_covariances,
)
from gscpe.viewer.texts import (
    legend_html,
    name_options,
    news_html,
    photo_html,
    refused_html,
    summary_html,
)

CAMERA = Camera.pinhole(64, 48, fx=60.0, fy=55.0, cx=30.0, cy=26.0)
STEPS = {
    "truth": [0.0] * 6,
    "coarse": [0.02, 0, 0, 0, 0, 0],
    "aligned": [0, 0.01, 0, 0, 0, 0],
    "final": [0, 0, 0.005, 0, 0, 0],
}


def detail(name: str, localized: bool = True, scale: float = 1.0) -> dict[str, Any]:
    poses = {
        stage: format_pose(scaled_pose(se3.exp(step) @ ROOM_POSE, scale))
        for stage, step in STEPS.items()
    }
    return {
        "name": name,
        "camera": CAMERA.colmap_text(),
        "status": "localized" if localized else "not localized",
        "reason": None if localized else "the <light> differs",
        "cam_from_world": poses["final"] if localized else None,
        "coarse": {"cam_from_world": poses["coarse"]},
        "aligned": {"cam_from_world": poses["aligned"]},
        "covariance": (scale**2 * 1e-4 * np.eye(6)).tolist() if localized else None,
    }


def test_frustum_corners_project_to_the_corners_of_the_photo(rng: np.random.Generator) -> None:
    pose = random_pose(rng)
    corners = frustum_corners(CAMERA, pose, 0.3)
    assert np.allclose(corners[0], camera_centre(pose))
    pixels = project(CAMERA, transform_points(pose, corners[1:5]))
    assert np.allclose(pixels, [(0, 0), (64, 0), (64, 48), (0, 48)])
    assert np.allclose(transform_points(pose, corners[1:])[:, 2], 0.3)


def test_a_photo_covers_what_it_shows() -> None:
    plane = photo_plane(CAMERA, 0.7)
    half = np.array([plane.width / 2, plane.height / 2, 0.0])
    pixels = project(CAMERA, np.stack([plane.centre - half, plane.centre + half]))
    assert np.allclose(pixels, [(0, 0), (64, 48)])


@pytest.mark.parametrize("aspect", [0.5, 1.3, 2.5])
def test_a_window_shows_the_whole_photo(aspect: float, rng: np.random.Generator) -> None:
    shown = ShownCamera("final", "a", random_pose(rng), CAMERA)
    point = viewpoint_of(shown, aspect)
    down = np.tan(point.vertical_angle / 2)
    x, y, z = transform_points(
        shown.cam_from_map, frustum_corners(CAMERA, shown.cam_from_map, 1.0)[1:5]
    ).T
    assert np.all(np.abs(y / z) <= down)
    assert np.all(np.abs(x / z) <= down * aspect)
    assert np.allclose(point.position, camera_centre(shown.cam_from_map))


def test_a_flight_begins_and_ends_where_it_should(rng: np.random.Generator) -> None:
    def point() -> Viewpoint:
        quaternion, position = se3.to_quaternion_translation(random_pose(rng))
        return Viewpoint(position, quaternion, float(rng.uniform(0.5, 1.5)))

    first, last = point(), point()
    for share, end in ((0.0, first), (1.0, last)):
        there = between(first, last, share)
        assert np.allclose(there.position, end.position)
        assert abs(there.quaternion @ end.quaternion) == pytest.approx(1.0)
        assert there.vertical_angle == pytest.approx(end.vertical_angle)


def test_an_ellipsoid_is_that_of_many_camera_centres(rng: np.random.Generator) -> None:
    pose = random_pose(rng)
    mixing = rng.normal(size=(6, 6)) * 1e-3
    covariance = mixing @ mixing.T
    draws = rng.multivariate_normal(np.zeros(6), covariance, size=4000)
    centres = np.array([camera_centre(se3.exp(xi) @ pose) for xi in draws])
    ellipsoid = centre_ellipsoid("a", pose, covariance, scale=1.0)
    axes = se3.from_quaternion_translation(ellipsoid.quaternion, [0, 0, 0])[:3, :3]
    along = (centres - ellipsoid.centre) @ axes
    assert np.allclose(np.std(along, axis=0), ellipsoid.radii, rtol=0.06)
    assert np.allclose(np.corrcoef(along.T), np.eye(3), atol=0.06)
    twice = centre_ellipsoid("a", pose, covariance, scale=2.0)
    assert np.allclose(twice.radii, 2 * ellipsoid.radii)


def test_a_sphere_is_closed_and_seen_from_outside() -> None:
    corners, triangles = sphere_mesh()
    assert np.allclose(np.linalg.norm(corners, axis=1), 1.0)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    thin = np.linalg.norm(normals, axis=1) < 1e-9  # at the poles
    assert np.all(np.sum(normals * (a + b + c), axis=1)[~thin] > 0)


def test_the_most_visible_gaussians_are_kept(rng: np.random.Generator) -> None:
    scene = random_scene(rng, 200, 1)
    scales = np.sort(scene.scales, axis=1)
    weight = scene.opacities * scales[:, 1] * scales[:, 2]
    kept = most_visible(scene, 50)
    assert len(kept) == 50
    assert np.array_equal(kept, np.sort(kept))
    assert weight[kept].min() >= np.delete(weight, kept).max()
    invisible = replace(scene, opacities=np.where(np.arange(200) < 190, 0, 1).astype(np.float32))
    assert np.array_equal(most_visible(invisible, 50), np.arange(190, 200))


def test_what_was_seen_from_near_counts_more(rng: np.random.Generator) -> None:
    """Area over squared distance to the nearest eye; nearer than the near plane, all are alike."""
    scene = random_scene(rng, 200, 1)
    eyes = rng.normal(size=(3, 3))
    apart = np.linalg.norm(scene.means[:, None] - eyes, axis=2).min(axis=1)
    scales = np.sort(scene.scales, axis=1)
    weight = scene.opacities * scales[:, 1] * scales[:, 2] / np.maximum(apart, scene.near) ** 2
    kept = most_visible(scene, 50, eyes)
    assert weight[kept].min() >= 0.999 * np.delete(weight, kept).max()
    assert not np.array_equal(kept, most_visible(scene, 50))
    assert np.array_equal(most_visible(scene, 50, np.zeros((0, 3))), most_visible(scene, 50))
    many = np.repeat(eyes, 1000, axis=0)
    assert np.array_equal(most_visible(scene, 50, many), kept)


def test_covariances_for_the_browser(rng: np.random.Generator) -> None:
    scene = random_scene(rng, 30, 1)
    splat = browser_splat(scene)
    for quaternion, scales, covariance in zip(
        scene.quaternions, scene.scales, splat.covariances, strict=True
    ):
        axes = se3.from_quaternion_translation(quaternion, [0, 0, 0])[:3, :3]
        assert np.allclose(covariance, axes @ np.diag(scales**2) @ axes.T, rtol=1e-3, atol=1e-7)
    # Half floats hold what is sent, of tiny and of huge Gaussians.
    for factor in (1e-4, 1.0, 1e4):
        scaled = browser_splat(replace(scene, scales=scene.scales * np.float32(factor)))
        sent = scaled_covariances(scaled, browser_unit(scaled))
        half = sent.astype(np.float16).astype(np.float32)
        assert np.all(np.isfinite(half))
        diagonal = np.einsum("nii->ni", sent)
        assert np.allclose(np.einsum("nii->ni", half), diagonal, rtol=0.05)


def test_a_section_cuts_a_box(rng: np.random.Generator) -> None:
    means = rng.uniform(-1, 1, (1000, 3)).astype(np.float32)
    means[0] = 50.0
    turned = se3.exp([0, 0, 0, 0.3, 0.2, -0.5])[:3, :3]
    section = Section.around(means, turned)
    assert np.all(section.inside(means))  # also what lies far outside
    middle = (section.limits[0] + section.limits[1]) / 2
    low = np.array([section.limits[0][0], section.limits[0][1], middle[2]])
    upper = Section(turned, low, section.high, section.limits).inside(means)
    assert np.array_equal(upper, means @ turned[2] >= middle[2])


@pytest.mark.parametrize(("scale", "metres"), [(1.0, 1.0), (10.0, 0.1), (3.0, None)])
def test_contents_are_in_the_maps_frame(scale: float, metres: float | None) -> None:
    """In a world of another unit, everything is shown as in the room itself."""
    map_ = room_map(scale, metres)
    truth = scaled_pose(ROOM_POSE, scale)
    found = Findings(
        details={"a.png": detail("a.png", scale=scale)},
        truth={"a.png": truth},
        trajectory={2.0: truth, 1.0: truth},
    )
    contents = contents_of(map_, found)
    shown = {camera.kind: camera for camera in contents.cameras}
    assert [camera.kind for camera in contents.cameras] == [
        *("reference", "truth", "coarse", "aligned", "final")
    ]
    unit = map_.frame.scale * scale  # map units per unit of the room
    for kind, step in STEPS.items():
        expected = camera_centre(se3.exp(step) @ ROOM_POSE)
        origin = map_.frame.origin / scale
        got = camera_centre(shown[kind].cam_from_map)  # type: ignore[index]
        assert np.allclose(got, unit * (expected - origin), atol=1e-6 * unit), kind
    assert np.allclose(contents.ellipsoids[0].radii, 0.01 * unit)
    assert contents.trajectory is not None
    assert contents.trajectory.times.tolist() == [1.0, 2.0]
    assert contents.trajectory.at(1.9) == 1
    assert np.allclose(contents.axes @ contents.axes.T, np.eye(3), atol=1e-9)
    assert 0.02 < contents.frustum_depth / contents.depth < 0.21


def test_photos_without_a_pose_are_listed_with_their_reason() -> None:
    details = {"a.png": detail("a.png"), "b.png": detail("b.png", localized=False)}
    contents = contents_of(room_map(), Findings(details=details))
    assert [(r.name, r.reason) for r in contents.refused] == [("b.png", "the <light> differs")]
    seen_from = contents.best("b.png")
    assert seen_from is not None
    assert (seen_from.kind, seen_from.trusted) == ("aligned", False)
    best = contents.best("a.png")
    assert best is not None
    assert best.kind == "final"
    assert contents.best("c.png") is None
    assert "the &lt;light&gt; differs" in refused_html(contents.refused)
    text = photo_html(seen_from, contents, room_map().frame, False)
    assert "Not localized: the &lt;light&gt; differs" in text
    assert "--images" in text


def test_names_that_are_no_text_can_be_sent() -> None:
    name = b"caf\xe9.png".decode("utf-8", "surrogateescape")
    contents = contents_of(room_map(), Findings(details={name: detail(name, False)}))
    (shown,) = contents.of_kind("coarse")
    for text in (
        refused_html(contents.refused),
        photo_html(shown, contents, room_map().frame, False),
        news_html(name),
        *name_options([name], {name}),
    ):
        assert "caf?.png" in text
        text.encode()
    assert name_options([name], ()) == {"caf?.png": name}


def test_many_cameras_are_thinned_and_the_page_says_so(rng: np.random.Generator) -> None:
    map_ = some_map(rng, references=20)
    contents = contents_of(map_, most_cameras=5)
    assert len(contents.of_kind("reference")) == 5
    splat = browser_splat(map_.scene, 10)
    text = summary_html("<b>", splat, contents)
    assert "5 of 20 reference photos" in text
    assert "&lt;b&gt;" in text
    assert "draws the 10" in text
    assert "reference (5)" in legend_html(contents)
    with pytest.raises(SettingsError):
        contents_of(map_, most_cameras=0)


def test_a_map_without_references_is_shown() -> None:
    map_ = room_map()
    nothing = replace(
        map_,
        references=replace(
            map_.references, names=(), cam_from_world=np.zeros((0, 4, 4)), cameras=()
        ),
        descriptors=replace(map_.descriptors, descriptors=map_.descriptors.descriptors[:0]),
    )
    contents = contents_of(nothing)
    assert contents.cameras == ()
    assert np.isfinite(contents.depth)
    assert np.allclose(contents.axes @ contents.axes.T, np.eye(3))


def test_files(tmp_path: Path) -> None:
    poses = {"a.png": ROOM_POSE}
    write_pose_file(tmp_path / "poses.txt", poses, "hloc")
    alone = read_findings(poses=tmp_path / "poses.txt")
    assert (list(alone.poses), alone.details) == (["a.png"], {})
    # The details that localize writes beside the poses are found.
    beside = tmp_path / "poses.details.jsonl"
    lines = [json.dumps(detail(name, name == "a.png")) for name in ("a.png", "b.png")]
    beside.write_text("\n".join(lines))
    assert list(read_findings(poses=tmp_path / "poses.txt").details) == ["a.png", "b.png"]
    # Also those of several maps; but those of track tell another story.
    write_pose_file(tmp_path / "poses.hall.txt", poses, "hloc")
    of_hall = read_findings(poses=tmp_path / "poses.hall.txt", map_name="hall")
    assert list(of_hall.details) == ["a.png", "b.png"]
    assert read_findings(poses=tmp_path / "poses.hall.txt", map_name="office").details == {}
    write_pose_file(tmp_path / "walk.txt", poses, "hloc")
    (tmp_path / "walk.details.jsonl").write_text('{"name": "a.png", "anchor_age": 0}\n')
    assert read_findings(poses=tmp_path / "walk.txt").details == {}
    with pytest.raises(PoseError, match="as gscpe localize writes them"):
        read_findings(details=tmp_path / "walk.details.jsonl")
    (tmp_path / "walk.tum").write_text(format_tum({"7": ROOM_POSE}, ["7"]))
    (tmp_path / "empty.tum").write_text("# nothing\n")
    walk = read_findings(trajectory=tmp_path / "walk.tum").trajectory
    assert list(walk) == [7.0]
    assert np.allclose(walk[7.0], ROOM_POSE)
    for details in ("missing.jsonl", "poses.txt"):
        with pytest.raises(PoseError):
            read_findings(details=tmp_path / details)
    for trajectory in ("poses.txt", "empty.tum"):
        with pytest.raises(PoseError):
            read_findings(trajectory=tmp_path / trajectory)


def test_photos_are_found_in_the_first_folder_that_has_them(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    from gscpe.photos import write_image

    image: NDArray[np.uint8] = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
    write_image(tmp_path / "one" / "a.png", image)
    write_image(tmp_path / "two" / "a.png", image[::-1].copy())
    write_image(tmp_path / "two" / "b.png", image[:40])
    photos = Photos([tmp_path / "one", tmp_path / "two"])
    shown = ShownCamera("final", "a.png", np.eye(4), CAMERA)
    whole = photos.picture(shown, 100)
    assert whole is not None
    assert np.array_equal(whole, image)
    small = photos.picture(shown, 32)
    assert small is not None
    assert small.shape == (24, 32, 3)
    assert photos.picture(replace(shown, name="b.png"), 32) is None  # not of the camera's size
    assert photos.picture(replace(shown, name="c.png"), 32) is None
    with pytest.raises(InputError):
        Photos([tmp_path / "three"])
