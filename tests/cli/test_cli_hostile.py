# SPDX-License-Identifier: Apache-2.0
"""Paths that lead nowhere good, in every place where a command takes one: a line, never a
traceback, and nothing is written over."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenes import ROOM_POSE, room, room_camera, room_map, write_colmap_model

from gscpe.cli.main import main
from gscpe.photos import write_image
from gscpe.poses.hloc import format_pose
from gscpe.scene import save_map
from gscpe.splats import write_splat

CAMERA = room_camera(64, 48)
WORDS = CAMERA.colmap_text()
POSE = format_pose(ROOM_POSE)

COMMANDS = [
    "build-map X --no-references --output new.gsmap",
    "build-map splat.ply --colmap X --images photos --output new.gsmap",
    "build-map splat.ply --colmap sparse --images X --output new.gsmap",
    "build-map splat.ply --colmap sparse --images photos --output new.gsmap --transform X",
    "localize X photos/a.png --camera CAMERA",
    "localize room.gsmap X --camera CAMERA",
    "localize room.gsmap photos/a.png --camera X",
    "localize room.gsmap photos/a.png --camera CAMERA --prior X",
    "localize room.gsmap --queries X --images photos --output poses.txt",
    "localize room.gsmap --queries list.txt --images X --output poses.txt",
    "localize room.gsmap --queries list.txt --images photos --output poses.txt --priors X",
    "track X photos --camera CAMERA --output new.tum",
    "track room.gsmap X --camera CAMERA --output new.tum",
    "track room.gsmap photos --camera X --output new.tum",
    "track room.gsmap photos --camera CAMERA --output new.tum --times X",
    "track room.gsmap photos --camera CAMERA --output new.tum --rate 1 --odometry X",
    "evaluate X poses.txt",
    "evaluate poses.txt X",
    "convert-poses X new.json",
    "convert-poses poses.txt new.txt --queries X",
    "view X --screenshot new.png",
    "view room.gsmap --screenshot new.png --poses X",
    "view room.gsmap --screenshot new.png --truth X",
    "view room.gsmap --screenshot new.png --trajectory X",
    "view room.gsmap --screenshot new.png --details X",
    "render X --pose POSE --camera CAMERA --output new",
    "render room.gsmap --pose X --camera CAMERA --output new",
    "make-map X --output new.gsmap",
    "make-map photos --output new.gsmap --masks X",
    "make-map photos --output new.gsmap --scale-from X",
    "make-map photos --output new.gsmap --scale-from points:X",
    "make-map photos --output new.gsmap --scale-from depth:X",
    "make-map photos --output new.gsmap --colmap X",
    "make-map photos --output new.gsmap --poses X --cameras list.txt",
    "make-map photos --output new.gsmap --poses poses.txt --cameras X",
    "reconstruct X --output new",
    "train --colmap X --images photos --output new.ply",
    "train --colmap sparse --images photos --output new.ply --masks X",
    "benchmark colmap sparse --images photos --every 2 --splat X --output new",
    "benchmark nerfstudio X --splat splat.ply --output new",
    "models install xfeat --from X",
]
HOSTILE = ("loop", "deep.json", "x" * 300)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile")
    map_ = room_map()
    save_map(map_, folder / "room.gsmap")
    write_splat(map_.scene, folder / "splat.ply")
    write_colmap_model(folder / "sparse", CAMERA, {"a.png": ROOM_POSE})
    write_image(folder / "photos" / "a.png", room().shoot(CAMERA, ROOM_POSE).uint8)
    (folder / "list.txt").write_text(f"a.png {WORDS}\n")
    (folder / "poses.txt").write_text(f"a.png {POSE}\n")
    (folder / "loop").symlink_to("loop")
    (folder / "deep.json").write_text("[" * 100_000)
    return folder


@pytest.mark.parametrize("command", COMMANDS)
def test_paths_that_lead_nowhere_good(
    command: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path))  # nothing is installed there
    for value in HOSTILE:
        names = {"CAMERA": WORDS.replace(" ", ","), "POSE": POSE}
        words = [names.get(word, word.replace("X", value)) for word in command.split()]
        try:
            status = main(words)
        except SystemExit as end:  # of argparse
            status = int(end.code or 0)
        out, err = capsys.readouterr()
        assert status == 2, (words, out, err)
        said = [line for line in err.splitlines() if line.startswith("gscpe ")]
        assert len(said) == 1, err
    made = {path for path in folder.rglob("new*/**/*.*") if path.is_file()}
    assert {path.name for path in made if path.parent.name != "images"} <= {"run.json"}


OUTPUTS = [
    "localize room.gsmap --queries list.txt --images photos --output X",
    "localize room.gsmap --queries list.txt --images photos --output new.txt --details X",
    "track room.gsmap photos --camera CAMERA --rate 1 --output X",
    "convert-poses poses.txt X --to hloc",
    "build-map splat.ply --no-references --output X",
    "render room.gsmap --pose POSE --camera CAMERA --output X",
    "view room.gsmap --screenshot X",
    "make-map photos --output X",
    "reconstruct photos --output X",
]


@pytest.mark.parametrize("command", OUTPUTS)
def test_outputs_that_cannot_be_written(
    command: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Before any long work: none of these finds a pose first."""
    monkeypatch.chdir(folder)
    for value in ("loop", "poses.txt/below"):
        names = {"CAMERA": WORDS.replace(" ", ","), "POSE": POSE}
        words = [names.get(word, word.replace("X", value)) for word in command.split()]
        assert main(words) == 2, words
        out, err = capsys.readouterr()
        assert out == ""
        assert len(err.strip().splitlines()) == 1, err


@pytest.mark.parametrize(
    "words",
    [
        ["render", "room.gsmap", "--pose", POSE, "--camera", WORDS, "--output", ""],
        ["convert-poses", "poses.txt", "new.txt", "--queries="],
        ["evaluate", "", "poses.txt"],
    ],
)
def test_empty_arguments_are_variables_that_are_not_set(
    words: list[str],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Else an output would be the current folder, and a list that was meant would be left out."""
    monkeypatch.chdir(folder)
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    assert "is a variable not set?" in capsys.readouterr().err
    assert not (folder / "rgb.png").exists()
    assert not (folder / "new.txt").exists()
