# SPDX-License-Identifier: Apache-2.0
"""The other subcommands: build-map, render, evaluate, doctor."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from helpers import write_splat
from scenes import (
    ROOM_POSE,
    room,
    room_camera,
    room_map,
    room_shot,
    scaled_pose,
    write_colmap_model,
)

from gscpe import __version__
from gscpe.cli import doctor
from gscpe.cli.main import main
from gscpe.geometry import pose_difference, se3
from gscpe.photos import read_image, write_image
from gscpe.poses.hloc import format_pose, parse_pose
from gscpe.scene import open_map, save_map

ROOT = Path(__file__).resolve().parents[2]
CAMERA = room_camera(240, 180)
ASIDE = se3.exp([0.05, -0.03, 0.04, 0.02, -0.02, 0.03]) @ ROOM_POSE
AROUND = se3.exp([0, 0, 0, 0, 0.5, 0]) @ ROOM_POSE


@pytest.fixture(scope="module")
def map_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map built through the command line of a splat, a COLMAP text model and two photos."""
    folder = tmp_path_factory.mktemp("built")
    write_splat(folder / "splat.ply", room_map().scene)
    poses = {"seq/b.png": AROUND, "seq/a.png": ROOM_POSE}
    write_colmap_model(folder / "sparse", CAMERA, poses)
    for name, pose in poses.items():
        write_image(folder / "photos" / name, room().shoot(CAMERA, pose).uint8)
    output = folder / "maps" / "room.gsmap"
    status = main(
        [
            *("build-map", str(folder / "splat.ply"), "--colmap", str(folder / "sparse")),
            *("--images", str(folder / "photos"), "--output", str(output)),
        ]
    )
    assert status == 0
    return output


def test_build_map(map_folder: Path) -> None:
    map_ = open_map(map_folder)
    assert len(map_.scene) == len(room_map().scene)
    assert map_.references.names == ("seq/a.png", "seq/b.png")
    np.testing.assert_allclose(map_.references.cam_from_world[0], ROOM_POSE, atol=1e-8)
    np.testing.assert_allclose(map_.references.cam_from_world[1], AROUND, atol=1e-8)
    assert map_.references.cameras == (CAMERA, CAMERA)
    assert map_.metres_per_unit == 1.0


def test_the_built_map_localizes(
    map_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photo = tmp_path / "query.png"
    write_image(photo, room().shoot(CAMERA, ASIDE).uint8)
    command = ["localize", str(map_folder), str(photo), "--camera", CAMERA.colmap_text(), "--json"]
    assert main(command) == 0
    detail = json.loads(capsys.readouterr().out)
    assert detail["reference"] == "seq/a.png"
    error = pose_difference(parse_pose(detail["cam_from_world"]), ASIDE)
    assert error.distance < 4e-3
    assert error.degrees < 0.1


@pytest.mark.parametrize(
    ("options", "unit"), [(["--metres-per-unit", "0.25"], 0.25), (["--unknown-scale"], None)]
)
def test_the_unit_of_a_map(
    options: list[str], unit: float | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_splat(tmp_path / "splat.ply", room_map().scene)
    write_colmap_model(tmp_path / "sparse", CAMERA, {"a.png": ROOM_POSE})
    write_image(tmp_path / "a.png", room().shoot(CAMERA, ROOM_POSE).uint8)
    output = tmp_path / "m.gsmap"
    command = ["build-map", str(tmp_path / "splat.ply"), "--colmap", str(tmp_path / "sparse")]
    assert main([*command, "--images", str(tmp_path), "--output", str(output), *options]) == 0
    out, err = capsys.readouterr()
    assert out == f"{output}: {len(room_map().scene)} Gaussians, 1 reference photos\n"
    assert err == ""
    assert open_map(output).metres_per_unit == unit


def test_render(map_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "pictures"
    command = ["render", str(map_folder), "--pose", format_pose(ROOM_POSE)]
    command += ["--camera", CAMERA.colmap_text(), "--output", str(folder)]
    assert main(command) == 0
    assert capsys.readouterr().err == ""
    names = ["depth.npy", "depth.png", "opacity.png", "rgb.png"]
    assert sorted(path.name for path in folder.iterdir()) == names
    depth = np.load(folder / "depth.npy")
    assert depth.shape == (180, 240)
    assert depth.dtype == np.float32
    opacity = read_image(folder / "opacity.png")[..., 0] / 255.0
    seen = opacity > 0.9
    assert seen.mean() > 0.95
    assert np.median(np.abs(depth - room_shot().depth)[seen]) < 3e-3
    rgb = read_image(folder / "rgb.png")
    assert np.abs(rgb.astype(float) - room_shot().uint8)[seen].mean() < 3.0
    assert read_image(folder / "depth.png").shape == (180, 240, 3)


@pytest.mark.parametrize(("scale", "metres"), [(10.0, 0.1), (3.0, None)])
def test_render_in_a_world_of_another_unit(
    tmp_path: Path, scale: float, metres: float | None
) -> None:
    """Pose and depth are the world's, in which the room is so many times as large."""
    save_map(room_map(scale, metres), tmp_path / "room.gsmap")
    command = ["render", str(tmp_path / "room.gsmap"), "--camera", CAMERA.colmap_text()]
    command += ["--pose", format_pose(scaled_pose(ROOM_POSE, scale))]
    assert main([*command, "--output", str(tmp_path / "view")]) == 0
    seen = read_image(tmp_path / "view" / "opacity.png")[..., 0] > 230
    assert seen.mean() > 0.95
    depth = np.load(tmp_path / "view" / "depth.npy")
    assert np.median(np.abs(depth / scale - room_shot().depth)[seen]) < 3e-3


def test_rendering_from_behind_shows_nothing(map_folder: Path, tmp_path: Path) -> None:
    away = se3.exp([0, 0, 0, 0, np.pi, 0]) @ ROOM_POSE
    command = ["render", str(map_folder), "--pose", format_pose(away)]
    assert main([*command, "--camera", "PINHOLE 40 30 35 35 20 15", "--output", str(tmp_path)]) == 0
    np.testing.assert_array_equal(np.load(tmp_path / "depth.npy"), np.zeros((30, 40), np.float32))
    assert not read_image(tmp_path / "rgb.png").any()


@pytest.fixture
def pose_files(tmp_path: Path) -> tuple[str, str]:
    """Estimates of three of four photos, one of them 3 cm off, and one of no known photo."""
    truth, estimates = tmp_path / "truth.txt", tmp_path / "estimates.txt"
    pose = format_pose(ROOM_POSE)
    off = np.array(ROOM_POSE)
    off[:3, 3] += off[:3, :3] @ [0.03, 0, 0]
    truth.write_text("".join(f"{name}.png {pose} 525.5\n" for name in "abcd"))
    estimates.write_text(
        f"a.png {pose}\nb.png {pose}\nc.png {format_pose(off)}\nother.png {pose}\n"
    )
    return str(estimates), str(truth)


def test_evaluate(pose_files: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", *pose_files]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    words = " ".join(out.split())
    assert "localized 3 of 4" in words
    assert "median position 0.000 cm" in words
    assert "within 5 cm / 5 deg 75.0 %" in words
    assert "within 2 cm / 2 deg 50.0 %" in words
    assert "1 estimates are of photos that are not in the truth list" in out


def test_evaluate_as_json(pose_files: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", *pose_files, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["queries"], data["localized"], data["not_in_truth"]) == (4, 3, 1)
    assert data["median_position_m"] == pytest.approx(0.0, abs=1e-8)
    assert [entry["share"] for entry in data["within"]] == [0.75, 0.75, 0.5, 0.5]
    assert data["within"][0]["position_m"] == 0.1


def test_evaluate_where_nothing_was_localized(
    pose_files: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    Path(pose_files[0]).write_text("")
    assert main(["evaluate", *pose_files, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["localized"] == 0
    assert data["median_position_m"] is None
    assert main(["evaluate", *pose_files]) == 0
    assert "localized        0 of 4" in capsys.readouterr().out


def test_doctor(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"gscpe {__version__}, Python ")
    for word in ("moderngl", "numpy", "pycolmap", "OpenGL", "everything works"):
        assert word in out
    assert "MISSING" not in out


def test_doctor_names_what_is_missing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lacking = {"uvicorn", "httpx", "faiss-cpu", "pyyaml"}
    version = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: None if name in lacking else version(name))
    main(["doctor"])
    lines = [line for line in capsys.readouterr().out.splitlines() if "missing (optional)" in line]
    told = dict(zip((line[:32].strip() for line in lines), lines, strict=True))
    for missing, extra in (("uvicorn, httpx", "serve"), ("faiss-cpu", "index"), ("pyyaml", "ros")):
        assert told[missing].endswith(f": pip install 'gscpe[{extra}]'")


def test_doctor_knows_every_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

    def names(requirements: list[str]) -> set[str]:
        return {re.split(r"[^\w-]", each)[0] for each in requirements}

    assert {*doctor._REQUIRED, *doctor._NOT_EVERYWHERE} == names(project["dependencies"])
    extras = project["optional-dependencies"]
    for_developers = {"test", "browser"}
    assert set(doctor._EXTRAS) == set(extras) - for_developers
    for extra, (packages, _) in doctor._EXTRAS.items():
        assert set(packages) == names(extras[extra])


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["localize", "--help"]])
def test_help_and_version(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 0
    out, err = capsys.readouterr()
    assert "gscpe" in out
    assert err == ""


@pytest.mark.parametrize("arguments", [[], ["fly"], ["evaluate", "only-one.txt"], ["render"]])
def test_commands_that_do_not_exist(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "error: " in capsys.readouterr().err
