# SPDX-License-Identifier: Apache-2.0
"""Pose files in hloc's form: read back as written; bad lines named by file and number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import random_pose
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gscpe.batch import write_poses
from gscpe.errors import OutputError, PoseError
from gscpe.geometry import se3
from gscpe.poses.hloc import format_pose, parse_pose, read_poses

IDENTITY = "1 0 0 0 0 0 0"

tangents = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)


@given(tangents)
def test_round_trip(xi: NDArray[np.float64]) -> None:
    pose = se3.exp(xi)
    text = format_pose(pose)
    assert len(text.split()) == 7
    np.testing.assert_allclose(parse_pose(text), pose, atol=2e-9)
    np.testing.assert_allclose(parse_pose(text.replace(" ", ", ")), pose, atol=2e-9)


def test_order_and_frames() -> None:
    """qw first, and world to camera: t is not the camera's centre."""
    pose = parse_pose("0.7071067811865476 0 0 0.7071067811865476 1 2 3")
    np.testing.assert_allclose(pose[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(pose @ [0, 0, 0, 1], [1, 2, 3, 1])
    assert format_pose(np.eye(4)) == IDENTITY


def test_quaternions_are_normalized() -> None:
    np.testing.assert_allclose(parse_pose("2 0 0 2 0 0 0"), parse_pose("1 0 0 1 0 0 0"))


@pytest.mark.parametrize(
    "text",
    ["", "1 0 0 0 0 0", "1 0 0 0 0 0 0 0", "a b c d e f g", "1;0;0;0;0;0;0", "1 0 0 0 0 0 x"],
)
def test_texts_that_are_no_poses(text: str) -> None:
    with pytest.raises(PoseError, match="is not of the form qw qx qy qz tx ty tz"):
        parse_pose(text)


@pytest.mark.parametrize("text", ["nan 0 0 0 0 0 0", "1 0 0 0 inf 0 0", "0 0 0 0 1 2 3"])
def test_impossible_numbers(text: str) -> None:
    with pytest.raises(PoseError, match=r"not finite|length zero"):
        parse_pose(text)


def test_files_are_read_back(tmp_path: Path, rng: np.random.Generator) -> None:
    poses = {f"seq-01/büro {i}.png".replace(" ", "_"): random_pose(rng) for i in range(20)}
    details = [
        {"name": name, "status": "localized", "aligned": {"cam_from_world": format_pose(pose)}}
        for name, pose in poses.items()
    ]
    write_poses(details, tmp_path / "new" / "poses.txt", "aligned")
    again = read_poses(tmp_path / "new" / "poses.txt")
    assert list(again) == list(poses)
    for name, pose in poses.items():
        np.testing.assert_allclose(again[name], pose, atol=2e-9)
    assert read_poses(str(tmp_path / "new" / "poses.txt")).keys() == poses.keys()


def test_comments_blank_lines_and_an_eighth_number(tmp_path: Path) -> None:
    """The 7-Scenes pseudo ground truth has the focal length there."""
    path = tmp_path / "poses.txt"
    path.write_text(f"# a comment\n\n  \na.png {IDENTITY} 525.505\r\n  b.png  {IDENTITY}  \n#end")
    poses = read_poses(path)
    assert list(poses) == ["a.png", "b.png"]
    np.testing.assert_array_equal(poses["a.png"], np.eye(4))


@pytest.mark.parametrize("more", ["", " 525.505", " 0.1 0.2"])
@pytest.mark.parametrize(
    "name", ["my photo.png", "my  old photo.png", "photo 1.png", '"quoted".png']
)
def test_names_with_blanks(name: str, more: str, tmp_path: Path) -> None:
    """The numbers are found from the end."""
    path = tmp_path / "poses.txt"
    path.write_text(f"{name} {IDENTITY}{more}\n{name}2 {IDENTITY}\n")
    assert list(read_poses(path)) == [name, f"{name}2"]


@pytest.mark.parametrize("name", ["photo 1", "IMG 2020 01 05"])
def test_names_that_end_in_a_number(name: str, tmp_path: Path) -> None:
    """The quaternion of unit length tells where the name ends."""
    path = tmp_path / "poses.txt"
    path.write_text(f"{name} 0.6 0.8 0 0 7 8 9\n")
    ((found, pose),) = read_poses(path).items()
    assert found == name
    np.testing.assert_array_equal(pose[:3, 3], [7, 8, 9])
    path.write_text("photo.png 0.6 0.8 0 0 7 8 9 525\n")
    ((found, pose),) = read_poses(path).items()
    assert found == "photo.png"
    np.testing.assert_array_equal(pose[:3, 3], [7, 8, 9])


@given(st.text(st.characters(codec="utf-8"), min_size=1, max_size=12), tangents)
def test_any_name_comes_back(
    tmp_path_factory: pytest.TempPathFactory, name: str, xi: NDArray[np.float64]
) -> None:
    """Blanks, quotes, numbers, what looks like a comment; only line breaks cannot be held."""
    path = tmp_path_factory.mktemp("poses") / "poses.txt"
    detail = {"name": name, "status": "localized", "cam_from_world": format_pose(se3.exp(xi))}
    if len(f"{name}.".splitlines()) > 1:
        with pytest.raises(OutputError, match="cannot be in a text file of poses"):
            write_poses([detail], path, "final")
        return
    write_poses([detail], path, "final")
    ((found, pose),) = read_poses(path).items()
    assert found == name
    np.testing.assert_allclose(pose, se3.exp(xi), atol=2e-9)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be"])
def test_other_encodings(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    mark = "\ufeff" if encoding.endswith("be") else ""
    path.write_bytes(f"{mark}büro.png {IDENTITY}\r\n".encode(encoding))
    assert list(read_poses(path)) == ["büro.png"]


def test_an_empty_file_holds_no_poses(tmp_path: Path) -> None:
    (tmp_path / "poses.txt").write_text("# nobody was localized\n")
    assert read_poses(tmp_path / "poses.txt") == {}


@pytest.mark.parametrize(
    "line",
    [
        "b.png 1 0 0 0 0 0",
        "b.png",
        f"b.png {IDENTITY} 525 7 7",
        f"b.png {IDENTITY} f",
        "b.png 1 0 0 0 0 zero 0",
        "b.png nan 0 0 0 0 0 0",
        "b.png 0 0 0 0 0 0 0",
        f"a.png {IDENTITY}",
        f"my photo.png {IDENTITY} 525 7 7",
        f'"my photo.png" {IDENTITY} 525 7 7',
        f'"my photo.png"x {IDENTITY[:-2]}',
    ],
)
def test_bad_lines_are_named(line: str, tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(f"# poses\na.png {IDENTITY}\n\n{line}\n")
    with pytest.raises(PoseError) as caught:
        read_poses(path)
    assert f"{path}, line 4: " in str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(PoseError, match=r"absent\.txt cannot be read"):
        read_poses(tmp_path / "absent.txt")
    with pytest.raises(PoseError, match="cannot be read"):
        read_poses(tmp_path)
    (tmp_path / "poses.txt").write_bytes(b"\x80\x81\xff\xfe")
    with pytest.raises(PoseError, match="is not a text file"):
        read_poses(tmp_path / "poses.txt")


def test_poses_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "poses.txt", tmp_path):
        with pytest.raises(OutputError, match="cannot be written"):
            write_poses([], path, "aligned")
