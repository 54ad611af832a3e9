# SPDX-License-Identifier: Apache-2.0
"""Photos in, a map out; interrupted and gone on with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import write_colmap_model
from walks import WALK_CAMERA, write_walk

from gscpe.cli.main import main
from gscpe.errors import ColmapModelError, OutputError, SettingsError, TrainingError
from gscpe.making import (
    KnownPoses,
    MakeMapSettings,
    make_map,
    read_certificate,
    work_folder_of,
)
from gscpe.poses import write_pose_file
from gscpe.reconstruction import PoseRefinementSettings, ScaleSource
from gscpe.scene import open_map

pytest.importorskip("numba")

COUNT = 9
SETTINGS = MakeMapSettings(iterations=40, max_gaussians=1500, test_every=4)


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, NDArray[np.float64]]]:
    folder = tmp_path_factory.mktemp("photos")
    return folder, write_walk(folder, COUNT)


def test_photos_become_a_map_in_one_command(
    photos: tuple[Path, dict[str, NDArray[np.float64]]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Interrupted while it trains; what was done before is not done again."""
    folder, poses = photos
    known = tmp_path / "known.txt"
    write_pose_file(known, poses, "hloc")
    output = tmp_path / "room.gsmap"
    command = [
        *("make-map", str(folder), "--output", str(output), "--scale-from", str(known)),
        *("--iterations", "40", "--max-gaussians", "1500", "--test-every", "4"),
    ]

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("gscpe.training.from_references.train", interrupted)
        assert main(command) == 130
    assert "go on from here with --resume" in capsys.readouterr().err
    assert main(command) == 2
    assert "interrupted" in capsys.readouterr().err
    with monkeypatch.context() as patch:
        patch.setattr("gscpe.reconstruction.colmap.extract", interrupted)  # is not called
        assert main([*command, "--resume"]) == 0
    out = capsys.readouterr().out
    assert "9 of 9 photos placed" in out
    assert "The map is" in out

    map_ = open_map(output)
    left_out = {"IMG_0000.jpg", "IMG_0004.jpg", "IMG_0008.jpg"}
    assert set(map_.references.names) == set(poses) - left_out
    assert map_.metres_per_unit == 1.0
    for name, pose in zip(
        map_.world_references.names, map_.world_references.cam_from_world, strict=True
    ):
        assert np.linalg.norm(pose[:3, 3] - poses[name][:3, 3]) < 0.1
    certificate = read_certificate(output)
    assert certificate is not None
    assert {photo.name for photo in certificate.photos} == left_out
    assert certificate.mean("psnr") > 10
    assert (output / "certificate.html").stat().st_size > 10_000

    for other in (["--scale-from", "distance:IMG_0000.jpg,IMG_0008.jpg,9"], ["--test-every", "2"]):
        assert main([*command, "--resume", *other]) == 2
        assert "only the training is done again" in capsys.readouterr().err


def test_known_poses(photos: tuple[Path, dict[str, NDArray[np.float64]]], tmp_path: Path) -> None:
    """Without structure from motion; points are triangulated. All photos are trained on."""
    folder, poses = photos
    upright = {name: pose for i, (name, pose) in enumerate(poses.items()) if i % 4 != 3}
    cameras = dict.fromkeys(upright, WALK_CAMERA)
    source = KnownPoses(folder, None, upright, cameras, metres_per_unit=0.5)
    settings = MakeMapSettings(iterations=5, max_gaussians=1000, test_every=0)
    made = make_map(source, tmp_path / "a.gsmap", settings)
    assert made.certificate is None and made.reconstruction is None
    assert made.references == len(upright)
    map_ = open_map(made.folder)
    assert map_.metres_per_unit == 0.5
    np.testing.assert_allclose(map_.world_references.cam_from_world[2], upright["IMG_0002.jpg"])

    refined = make_map(
        source, tmp_path / "refined.gsmap", settings, refinement=PoseRefinementSettings()
    )
    assert refined.reconstruction is not None and refined.reconstruction.refined is not None
    assert refined.references == len(refined.reconstruction.placed) == len(upright)
    assert open_map(refined.folder).metres_per_unit == 0.5

    with pytest.raises(SettingsError, match="metres_per_unit"):
        make_map(source, tmp_path / "b.gsmap", settings, ScaleSource("gps"))
    with pytest.raises(TrainingError, match="--test-every 0"):
        three = KnownPoses(folder, None, dict(list(upright.items())[:3]), cameras)
        make_map(three, tmp_path / "three.gsmap", MakeMapSettings(test_every=8))
    with pytest.raises(TrainingError, match="at least 3"):
        few = KnownPoses(folder, None, dict(list(upright.items())[:2]), cameras)
        make_map(few, tmp_path / "c.gsmap", settings)


def test_models_of_other_photos(
    photos: tuple[Path, dict[str, NDArray[np.float64]]], tmp_path: Path
) -> None:
    folder, _ = photos
    write_colmap_model(tmp_path / "model", WALK_CAMERA, {"other.jpg": np.eye(4)})
    with pytest.raises(ColmapModelError, match="not in"):
        make_map(KnownPoses(folder, tmp_path / "model"), tmp_path / "a.gsmap", SETTINGS)
    with pytest.raises(ColmapModelError, match="not a folder"):
        make_map(KnownPoses(folder, tmp_path / "nothing"), tmp_path / "b.gsmap", SETTINGS)


def test_outputs_that_are_something_else(
    photos: tuple[Path, dict[str, NDArray[np.float64]]], tmp_path: Path
) -> None:
    folder, _ = photos
    output = tmp_path / "notes"
    output.mkdir()
    (output / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="not a gscpe map"):
        make_map(folder, output, SETTINGS)
    work = work_folder_of(tmp_path / "a.gsmap")
    work.mkdir()
    (work / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="not of gscpe"):
        make_map(folder, tmp_path / "a.gsmap", SETTINGS)
    assert (work / "mine.txt").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--colmap", "m", "--poses", "p"], "not both"),
        (["--poses", "p"], "go together"),
        (["--metres-per-unit", "2"], "go with"),
        (["--unknown-scale"], "go with"),
        (["--refine-poses"], "only known poses are refined"),
        (["--colmap", "m", "--refine-focal-length"], "goes with --refine-poses"),
        (["--test-every", "1"], "test_every"),
        (["--scale-from", "nothing.txt"], "no file of known poses"),
        ([], "no folder of photos"),
    ],
)
def test_bad_arguments(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["make-map", str(tmp_path / "none"), "--output", str(tmp_path / "a"), *arguments]
    try:
        status = main(command)
    except SystemExit as exit_:
        status = int(exit_.code or 0)
    assert status == 2
    assert message in capsys.readouterr().err
