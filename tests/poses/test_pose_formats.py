# SPDX-License-Identifier: Apache-2.0
"""Pose files of every form: read back as written, told from each other, bad lines named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import random_pose, simple_camera
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gscpe.cli.main import main
from gscpe.errors import OutputError, PoseError
from gscpe.geometry import Camera
from gscpe.poses import (
    POSE_FORMATS,
    PoseFormat,
    detect_format,
    format_of_path,
    poses_by_name,
    read_pose_file,
    write_colmap_folder,
    write_pose_file,
)

Poses = dict[str, NDArray[np.float64]]

LINES = {
    "hloc": "a.png 1 0 0 0 1 2 3",
    "pgt": "a.png 1 0 0 0 1 2 3 525.5",
    "colmap": "7 1 0 0 0 1 2 3 1 a.png\n",
    "tum": "1305031102.1753 -1 -2 -3 0 0 0 1",
    "json": '[{"name": "a.png", "cam_from_world": "1 0 0 0 1 2 3"}]',
}


@pytest.fixture
def poses(rng: np.random.Generator) -> Poses:
    """Up to a kilometre from the origin."""
    poses = {f"seq-01/frame-{i:06d}.color.png": random_pose(rng) for i in range(12)}
    for pose in list(poses.values())[::2]:
        pose[:3, 3] *= 400.0
    return poses


@pytest.fixture
def cameras(poses: Poses) -> dict[str, Camera]:
    return {name: simple_camera(64 + i % 2, 48) for i, name in enumerate(poses)}


@pytest.mark.parametrize("kind", POSE_FORMATS)
def test_files_are_read_back(
    kind: PoseFormat, poses: Poses, cameras: dict[str, Camera], tmp_path: Path
) -> None:
    path = tmp_path / "new" / "poses"
    write_pose_file(path, poses, kind, cameras)
    again = read_pose_file(path)
    assert again.format == kind
    found = again.poses
    if kind == "tum":
        assert list(found) == [str(i) for i in range(len(poses))]
        found, how = poses_by_name(found, list(poses))
        assert how == "position"
    assert list(found) == list(poses)
    for name, pose in poses.items():
        np.testing.assert_allclose(found[name], pose, rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", POSE_FORMATS)
def test_frames_and_order(kind: PoseFormat) -> None:
    """The same camera in all forms: TUM's is camera to world, with qw last."""
    text = LINES[kind]
    assert detect_format(text, "f") == kind
    assert detect_format(f"\n  \n{'' if kind == 'json' else '# comment'}\n{text}", "f") == kind


@pytest.mark.parametrize("kind", ["hloc", "pgt", "json"])
def test_names_with_blanks_are_read_back(kind: PoseFormat, poses: Poses, tmp_path: Path) -> None:
    names = ("my photo.png", "photo 1", "a  b.png", '"q".png', "büro 2.jpg", "7 8.png")
    named = dict(zip(names, poses.values(), strict=False))
    cameras = dict.fromkeys(named, simple_camera())
    for first in names:  # the form is told by the first line
        order = {first: named[first], **named}
        write_pose_file(tmp_path / "poses", order, kind, cameras)
        again = read_pose_file(tmp_path / "poses")
        assert again.format == kind
        assert list(again.poses) == list(order)
        for name, pose in order.items():
            np.testing.assert_allclose(again.poses[name], pose, rtol=0, atol=1e-9)


def test_colmap_names_with_blanks_are_read(tmp_path: Path) -> None:
    path = tmp_path / "images.txt"
    path.write_text("1 1 0 0 0 1 2 3 1 my photo 1.png\n1 2 -1\n2 1 0 0 0 4 5 6 1 b 7\n\n")
    found = read_pose_file(path)
    assert (found.format, list(found.poses)) == ("colmap", ["my photo 1.png", "b 7"])


@pytest.mark.parametrize("output", ["model", "model/images.txt"])
def test_pycolmap_opens_what_is_converted(
    output: str, poses: Poses, cameras: dict[str, Camera], tmp_path: Path
) -> None:
    """The whole model: cameras, images, points3D; names with blanks where it is binary."""
    pycolmap = pytest.importorskip("pycolmap")
    if output == "model":
        poses = {name.replace("frame-", "my frame "): pose for name, pose in poses.items()}
    bent = Camera.from_colmap("RADIAL", 64, 48, [55, 32, 24, -0.1, 0.02])
    named = dict(zip(poses, [*list(cameras.values())[:-1], bent], strict=True))
    lines = [f"{name} {camera.colmap_text()}\n" for name, camera in named.items()]
    (tmp_path / "queries.txt").write_text("".join(lines))
    write_pose_file(tmp_path / "poses.txt", poses, "hloc")
    paths = [str(tmp_path / name) for name in ("poses.txt", output)]
    assert main(["convert-poses", *paths, "--queries", str(tmp_path / "queries.txt")]) == 0
    model = pycolmap.Reconstruction(str(tmp_path / "model"))
    assert {image.name for image in model.images.values()} == set(poses)
    assert len(model.cameras) == 3
    for image in model.images.values():
        found = image.cam_from_world().matrix()
        np.testing.assert_allclose(found, poses[image.name][:3], atol=2e-9)
        camera = model.cameras[image.camera_id]
        words = [camera.model.name, str(camera.width), str(camera.height)]
        ours = Camera.parse(" ".join([*words, *map(repr, map(float, camera.params))]))
        assert ours == named[image.name]


def test_what_is_replaced_is_kept(poses: Poses, cameras: dict[str, Camera], tmp_path: Path) -> None:
    """Also a COLMAP model with points, which somebody names by mistake."""
    write_pose_file(tmp_path / "poses.txt", poses, "hloc")
    lines = [f"{name} {camera.colmap_text()}\n" for name, camera in cameras.items()]
    (tmp_path / "queries.txt").write_text("".join(lines))
    model = tmp_path / "model"
    model.mkdir()
    others = [model / "cameras.bin", model / "images.bin", model / "points3D.bin"]
    others.append(tmp_path / "poses.tum")
    for path in others:
        path.write_bytes(b"somebody's")
    options = ["--queries", str(tmp_path / "queries.txt")]
    for output in ("model", "poses.tum", "new.json"):
        names = [str(tmp_path / "poses.txt"), str(tmp_path / output)]
        assert main(["convert-poses", *names, *options]) == 0
    for path in others:
        assert path.with_name(path.name + ".bak").read_bytes() == b"somebody's"
        assert path.read_bytes() != b"somebody's"
    assert not (tmp_path / "new.json.bak").exists()


def test_a_colmap_folder_needs_cameras_and_no_rigs(
    poses: Poses, cameras: dict[str, Camera], tmp_path: Path
) -> None:
    with pytest.raises(PoseError, match="needs the cameras"):
        write_colmap_folder(tmp_path / "model", poses, None)
    (tmp_path / "frames.bin").touch()
    with pytest.raises(OutputError, match=r"another COLMAP model with frames\.bin"):
        write_colmap_folder(tmp_path, poses, cameras)


def test_tum_against_scipy(poses: Poses, tmp_path: Path) -> None:
    named = {f"rgb/{1311868164.25 + i / 8:.6f}.png": p for i, p in enumerate(poses.values())}
    write_pose_file(tmp_path / "a.tum", dict(reversed(named.items())), "tum")
    table = np.loadtxt(tmp_path / "a.tum")
    np.testing.assert_array_equal(table[:, 0], 1311868164.25 + np.arange(len(poses)) / 8)
    for row, pose in zip(table, poses.values(), strict=True):
        world_from_cam = np.linalg.inv(pose)
        np.testing.assert_allclose(row[1:4], world_from_cam[:3, 3], atol=1e-8)
        rotation = Rotation.from_quat(row[4:]).as_matrix()
        np.testing.assert_allclose(rotation, world_from_cam[:3, :3], atol=1e-9)


def test_colmap_reads_what_is_written(
    poses: Poses, cameras: dict[str, Camera], tmp_path: Path
) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    write_pose_file(tmp_path / "images.txt", poses, "colmap", cameras)
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 64 48 55 55 32 24\n2 PINHOLE 65 48 1 1 1 1\n")
    (tmp_path / "points3D.txt").write_text("")
    model = pycolmap.Reconstruction(str(tmp_path))
    assert [image.camera_id for _, image in sorted(model.images.items())] == [1, 2] * 6
    for image in model.images.values():
        pose = poses[image.name]
        np.testing.assert_allclose(image.cam_from_world().matrix(), pose[:3], atol=1e-9)


def test_colmap_files_with_points(tmp_path: Path) -> None:
    path = tmp_path / "images.txt"
    path.write_text(
        "# Image list\n1 1 0 0 0 1 2 3 1 a.png\n10.5 20.5 -1 30 40 17\n"
        "2 1 0 0 0 4 5 6 1 b.png\n\n3 1 0 0 0 7 8 9 2 c.png"
    )
    found = read_pose_file(path)
    assert found.format == "colmap"
    assert {name: pose[0, 3] for name, pose in found.poses.items()} == {
        "a.png": 1.0,
        "b.png": 4.0,
        "c.png": 7.0,
    }


def test_dsac_estimates_have_two_more_numbers(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("seq-03/frame-000000.color.png 1 0 0 0 1 2 3 0.105043 0.001328\n")
    assert read_pose_file(path).format == "hloc"
    assert list(read_pose_file(path).poses) == ["seq-03/frame-000000.color.png"]


def test_details_are_read(tmp_path: Path) -> None:
    camera = simple_camera()
    lines = [
        {"name": "a.png", "camera": camera.colmap_text(), "cam_from_world": None},
        {"name": "b.png", "camera": camera.colmap_text(), "cam_from_world": "1 0 0 0 1 2 3"},
    ]
    path = tmp_path / "details.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    found = read_pose_file(path)
    assert (found.format, list(found.poses)) == ("json", ["b.png"])
    assert found.cameras == {"a.png": camera, "b.png": camera}
    with path.open("a") as file:
        file.write('{"name": "c.png", "cam_fr')
    with pytest.raises(PoseError, match=r"details\.jsonl, line 3: not JSON"):
        read_pose_file(path)


def test_photos_named_by_numbers_are_told_by_the_quaternions(tmp_path: Path) -> None:
    """Eight numbers a line: hloc's or TUM's."""
    assert detect_format("17 0.6 0 0.8 0 1 2 3", "f") == "hloc"
    assert detect_format("17 1 2 3 0.6 0 0.8 0", "f") == "tum"
    identity = "17 1 0 0 0 0 0 0"
    assert detect_format(identity, "f") == "hloc"
    both = "17 1 0 0 0 0 0 1"  # a quaternion of length 1 either way
    with pytest.raises(PoseError, match=r"f, line 1: '17 1 .* may be of the form hloc or tum"):
        detect_format(both, "f")
    assert detect_format(f"{both}\n18 1 2 3 0 0 0 1", "f") == "tum"
    (tmp_path / "p.txt").write_text(both)
    assert read_pose_file(tmp_path / "p.txt", "tum").poses["17"][0, 3] == -1.0
    assert read_pose_file(tmp_path / "p.txt", "hloc").poses["17"][2, 3] == 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello", "line 1: expected 'name qw qx qy qz tx ty tz'.*or JSON; got 'hello'"),
        ("1 2 3 4 5 6 7", "line 1: expected .*; got '1 2 3 4 5 6 7'"),
        (LINES["hloc"] + "\nb.png 1 0 0 0 1 2", "line 2: expected 'name qw"),
        (LINES["hloc"] + "\n" + LINES["hloc"], "line 2: a.png already has a pose"),
        (LINES["tum"] + "\n1305031103 1 2 3 0 0 0", "line 2: expected 'timestamp tx"),
        (LINES["tum"] + "\n1305031103 1 2 3 0 0 0 x", "line 2: expected 'timestamp tx"),
        (LINES["tum"] + "\n1305031103 1 2 3 0 0 0 0", "line 2: .*length zero"),
        (LINES["tum"] + "\n" + LINES["tum"], "line 2: 1305031102.1753 already has a pose"),
        (LINES["colmap"] + LINES["colmap"][:-3], "line 2: expected the points of the photo"),
        (LINES["colmap"] + "\n8 1 0 0 0 1 2 3 1", "line 3: expected 'IMAGE_ID QW"),
        (LINES["colmap"] + "\n8 nan 0 0 0 1 2 3 1 b.png", "line 3: .*not finite"),
        (LINES["colmap"] + "\n" + LINES["colmap"], "line 3: a.png already has a pose"),
        ('{"poses": [\n{"name"', "line 2: not JSON"),
        ('{"format": "other", "poses": []}', "has format 'other'"),
        ('{"poses": [3]}', "pose 1: expected an object with"),
        ('[{"name": "a"}]', "pose 1: a has no"),
        ('[{"name": "a", "cam_from_world": [1, 2]}]', "pose 1, a: .*4x4"),
        ('[{"name": "a", "cam_from_world": "1 0"}]', "pose 1, a: .*qw qx qy qz"),
        ('[{"name": "a", "camera": "?", "cam_from_world": null}]', "pose 1, a: camera"),
    ],
)
def test_bad_files_are_named(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "poses"
    path.write_text(text)
    with pytest.raises(PoseError, match=message) as caught:
        read_pose_file(path)
    assert str(caught.value).startswith(str(path))


def test_json_that_contradicts_itself(poses: Poses, tmp_path: Path) -> None:
    path = tmp_path / "poses.json"
    write_pose_file(path, poses, "json")
    data = json.loads(path.read_text())
    data["poses"][3]["translation"][0] += 0.01
    path.write_text(json.dumps(data))
    with pytest.raises(PoseError, match=r"pose 4, .*are not those of cam_from_world"):
        read_pose_file(path)


@pytest.mark.parametrize("kind", POSE_FORMATS)
def test_no_poses_at_all(kind: PoseFormat, tmp_path: Path) -> None:
    write_pose_file(tmp_path / "poses", {}, kind)
    assert read_pose_file(tmp_path / "poses").poses == {}


def test_what_a_form_cannot_hold(poses: Poses, tmp_path: Path) -> None:
    path, pose = tmp_path / "poses", np.eye(4)
    write_pose_file(path, {"my photo.png": pose}, "json")
    assert list(read_pose_file(path).poses) == ["my photo.png"]
    with pytest.raises(PoseError, match=r"blanks in its name.*give a folder"):
        write_pose_file(path, {"my photo.png": pose}, "colmap")
    lines: tuple[PoseFormat, ...] = ("hloc", "pgt")
    for kind in lines:
        with pytest.raises(OutputError, match="cannot be in a text file"):
            write_pose_file(path, {"a\nb.png": pose}, kind, {"a\nb.png": simple_camera()})
    with pytest.raises(PoseError, match=r"needs the focal length of a\.png"):
        write_pose_file(path, {"a.png": pose}, "pgt")
    wide = Camera.pinhole(64, 48, fx=50, fy=60, cx=32, cy=24)
    with pytest.raises(PoseError, match="50 and 60"):
        write_pose_file(path, {"a.png": pose}, "pgt", {"a.png": wide})
    others: tuple[PoseFormat, ...] = ("colmap", "tum")
    for kind in others:
        with pytest.raises(PoseError, match=r"a\.png has a pose, but"):
            write_pose_file(path, {"a.png": pose}, kind, {"b.png": wide})
    with pytest.raises(OutputError, match="cannot be written"):
        write_pose_file(tmp_path, poses, "hloc")


def test_timestamps_are_matched(poses: Poses) -> None:
    values = list(poses.values())[:3]
    names = ["rgb/1311868164.363181.png", "rgb/1311868164.399026.png", "rgb/1311868165.5.png"]
    stamps = ["1.311868164363181114e+09", "1311868165.5", "7"]
    found, how = poses_by_name(dict(zip(stamps, values, strict=True)), names)
    assert how == "number"
    assert list(found) == [names[0], names[2], "7"]
    # Positions count photos without a pose.
    found, how = poses_by_name({"2": values[0], "0": values[1]}, ["a.png", "b.png", "c.png"])
    assert (list(found), how) == (["c.png", "a.png"], "position")
    with pytest.raises(PoseError, match=r"not the photos' numbers, nor .*'3' against 'a\.png'"):
        poses_by_name({"3": values[0]}, ["a.png", "b.png", "c.png"])
    with pytest.raises(PoseError, match="two timestamps"):
        poses_by_name({"5": values[0], "5.0000005": values[1]}, ["5.png"])


def test_equal_numbers_in_two_folders_are_counted(tmp_path: Path) -> None:
    poses = {"a/0001.png": np.eye(4), "b/0001.png": np.eye(4)}
    write_pose_file(tmp_path / "p.tum", poses, "tum")
    assert list(read_pose_file(tmp_path / "p.tum").poses) == ["0", "1"]


@pytest.mark.parametrize(
    ("name", "kind"),
    [("images.txt", "colmap"), ("p.txt", "hloc"), ("p.tum", "tum"), ("p.JSON", "json")],
)
def test_names_stand_for_forms(name: str, kind: PoseFormat) -> None:
    assert format_of_path(f"folder/{name}") == kind
    with pytest.raises(PoseError, match=r"the file ending of p\.xyz does not say"):
        format_of_path("p.xyz")


def test_conversions_by_command(
    poses: Poses, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Around through all forms, with a photo in the list that has no pose."""
    names = ["not-localized.png", *poses]
    queries = tmp_path / "queries.txt"
    queries.write_text("".join(f"{name} {simple_camera().colmap_text()}\n" for name in names))
    first = tmp_path / "poses.txt"
    write_pose_file(first, poses, "hloc")
    path = first
    for name in ("poses.tum", "poses.json", "images.txt", "pgt.txt"):
        options = ["--to", "pgt"] if name == "pgt.txt" else []
        command = ["convert-poses", str(path), str(tmp_path / name), "--queries", str(queries)]
        assert main([*command, *options]) == 0
        path = tmp_path / name
    assert capsys.readouterr().out.splitlines()[-1] == f"{path}: 12 poses, colmap to pgt"
    assert list(np.loadtxt(tmp_path / "poses.tum")[:, 0]) == list(range(1, 13))
    again = read_pose_file(path)
    assert (again.format, list(again.poses)) == ("pgt", list(poses))
    for name, pose in poses.items():
        np.testing.assert_allclose(again.poses[name], pose, atol=4e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["p.txt", "p.txt"], "is also the input"),
        (["p.txt", "out.xyz"], "does not say which form"),
        (["p.txt", "out.txt", "--to", "pgt"], "needs the focal length of a.png"),
        (["p.txt", "out.txt", "--from", "colmap"], "line 1: expected 'IMAGE_ID"),
        (["absent.txt", "out.txt"], "cannot be read"),
    ],
)
def test_conversions_that_fail(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("p.txt").write_text(LINES["hloc"])
    assert main(["convert-poses", *arguments]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert message in err
    assert not Path("out.txt").exists()
