# SPDX-License-Identifier: Apache-2.0
"""``gscpe train``: a whole run, interruption, and bad input."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from scenes import write_colmap_model
from test_train import shots

from gscpe.cli.main import main
from gscpe.photos import read_image, write_image
from gscpe.splats import read_splat
from gscpe.training.trainer import Trainer


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A COLMAP model, photos, and points."""
    photos, poses, points = shots()
    names = [f"{i}.png" for i in range(len(photos))]
    for name, photo in zip(names, photos, strict=True):
        write_image(tmp_path / "photos" / name, photo.rgb)
    camera = photos[0].camera
    write_colmap_model(tmp_path / "model", camera, dict(zip(names, poses, strict=True)))
    lines = [
        f"{i} {x!r} {y!r} {z!r} {r} {g} {b} 0"
        for i, ((x, y, z), (r, g, b)) in enumerate(
            zip(points.positions.tolist(), points.colours.tolist(), strict=True), start=1
        )
    ]
    (tmp_path / "model" / "points3D.txt").write_text("\n".join(lines) + "\n")
    return tmp_path


def train(folder: Path, *options: str, length: tuple[str, ...] = ("--iterations", "30")) -> int:
    return main(
        [
            *("train", "--colmap", str(folder / "model"), "--images", str(folder / "photos")),
            *("--output", str(folder / "room.ply"), "--max-gaussians", "1500", *length, *options),
        ]
    )


def test_from_a_model_to_a_splat(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert train(folder, "--test-every", "5") == 0
    said = capsys.readouterr().out
    scene = read_splat(folder / "room.ply")
    assert scene.sh_degree == 3 and len(scene) <= 1500
    assert f"{len(scene)} Gaussians from 8 photos in 30 iterations" in said
    assert "PSNR of 2 photos left out" in said
    assert sorted(path.name for path in folder.iterdir()) == ["model", "photos", "room.ply"]
    first = (folder / "room.ply").read_bytes()
    assert train(folder, "--test-every", "5") == 0
    assert (folder / "room.ply").read_bytes() == first
    assert (folder / "room.ply.bak").read_bytes() == first


def test_masks_leave_things_out(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is masked is neither learned nor counted: another picture there changes nothing."""
    mask = np.full((*read_image(folder / "photos" / "1.png").shape[:2], 3), 255, dtype=np.uint8)
    mask[:, :20] = 0
    for i in range(10):
        write_image(folder / "masks" / f"{i}.png", mask)
    masked = "--masks", str(folder / "masks"), "--test-every", "5"
    assert train(folder, *masked) == 0
    first, said = (folder / "room.ply").read_bytes(), capsys.readouterr().out
    for i in range(10):
        image = read_image(folder / "photos" / f"{i}.png").copy()
        image[:, :20] = (255, 0, 200)
        write_image(folder / "photos" / f"{i}.png", image)
    assert train(folder, *masked) == 0
    assert (folder / "room.ply").read_bytes() == first
    assert capsys.readouterr().out == said
    assert train(folder, "--test-every", "5") == 0
    assert (folder / "room.ply").read_bytes() != first

    (folder / "room.ply").unlink()
    write_image(folder / "masks" / "3.png", np.zeros_like(mask))
    assert train(folder, *masked) == 2
    assert "black everywhere" in capsys.readouterr().err
    assert train(folder, "--masks", str(folder / "model")) == 2
    assert "no mask of these photos" in capsys.readouterr().err


def test_interrupted_and_resumed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train(folder) == 0
    whole = (folder / "room.ply").read_bytes()
    (folder / "room.ply").unlink()
    step = Trainer.step

    def interrupted(self: Trainer) -> None:
        step(self)
        if self.progress().iteration == 12:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "step", interrupted)
        assert train(folder) == 130
    assert "--resume" in capsys.readouterr().err
    assert train(folder) == 2  # what is there is not thrown away
    assert "interrupted training: continue with --resume, or delete it" in capsys.readouterr().err
    assert train(folder, "--resume") == 0
    assert (folder / "room.ply").read_bytes() == whole


def test_minutes(folder: Path) -> None:
    assert train(folder, length=("--minutes", "0.03")) == 0
    assert len(read_splat(folder / "room.ply")) <= 1500


def test_bad_input(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def told(*options: str, length: tuple[str, ...] = ("--iterations", "3")) -> str:
        assert train(folder, *options, length=length) == 2
        return capsys.readouterr().err

    assert "no checkpoint" in told("--resume")
    assert "minutes must be" in told(length=("--minutes", "0"))
    assert "sh_degree must be" in told("--sh-degree", "4")
    assert "max_gaussians must be" in told("--max-gaussians", "3")
    assert "test_every must be 0, or 2 and more" in told("--test-every", "1")
    assert ".ply or .spz" in told("--output", str(folder / "room.png"))
    assert "cannot be written" in told("--output", "/proc/nothing/room.ply")
    assert "is not a folder" in told("--colmap", str(folder / "none"))
    points = folder / "model" / "points3D.txt"
    whole = points.read_text()
    points.write_text("# none\n")
    assert "has no points, and triangulating them failed" in told()  # too small to match
    points.write_text(whole)
    write_image(folder / "photos" / "3.png", np.zeros((10, 10, 3), dtype=np.uint8))
    assert "3.png is 10x10, but its camera is 64x48" in told()
    (folder / "photos" / "4.png").write_bytes(b"")
    (folder / "photos" / "3.png").unlink()
    assert "are not in" in told()
    poses = folder / "model" / "images.txt"
    poses.write_text("\n".join(poses.read_text().splitlines()[:5]) + "\n")
    assert "2 photos have a pose" in told("--test-every", "0")
