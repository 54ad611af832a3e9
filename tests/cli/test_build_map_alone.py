# SPDX-License-Identifier: Apache-2.0
"""``gscpe build-map --virtual-references``: a map from a splat alone."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
from helpers import write_splat
from scenes import furnished_room, splat_of

from gscpe.cli import build_map_alone
from gscpe.cli.main import main
from gscpe.geometry import Camera
from gscpe.making import Certificate, CertificateSettings, CertifiedPhoto, read_certificate
from gscpe.scene import Map, open_map
from gscpe.viewpoints import ViewpointSettings

CAMERA = "PINHOLE,120,90,100,100,60,45"


@pytest.fixture(scope="module")
def splat(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("alone") / "room.ply"
    write_splat(path, splat_of(furnished_room()))
    return path


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer places and views than usual, to be quick."""
    quick = functools.partial(ViewpointSettings, most=12, seeds=6, grown=6, between=6)
    monkeypatch.setattr(build_map_alone, "ViewpointSettings", quick)


@pytest.mark.usefixtures("few")
def test_a_map_is_made_of_a_splat_alone(
    splat: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "m.gsmap"
    command = ["build-map", str(splat), "--virtual-references", "--camera", CAMERA]
    assert main([*command, "--output", str(output), "--no-check"]) == 0
    printed = capsys.readouterr().out
    assert read_certificate(output) is None
    map_ = open_map(output)
    assert f"{len(map_.references)} virtual references, no photos" in printed
    assert "up was taken to be" in printed and "--up" in printed
    assert map_.references.virtual and 3 <= len(map_.references) <= 12
    assert map_.references.cameras[0] == Camera.parse(CAMERA)
    centres = np.linalg.inv(map_.world_references.cam_from_world)[:, :3, 3]
    assert np.all(np.abs(centres) < [2.0, 1.7, 2.4]) and np.all(centres[:, 2] > 0)


@pytest.mark.usefixtures("few")
def test_what_is_up_can_be_said(
    splat: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["build-map", str(splat), "--virtual-references", "--camera", CAMERA]
    output = str(tmp_path / "m.gsmap")
    options = ["--no-check", "--unknown-scale", "--output", output]
    assert main([*command, "--up=0,0,-1", *options]) == 0
    assert "up was taken" not in capsys.readouterr().out
    map_ = open_map(output)
    assert map_.metres_per_unit is None
    assert (map_.references.cam_from_world[:, 1, 2]).min() > 0.9  # the images' down is +z


def certificate_of(found: int, distance: float) -> Certificate:
    """Of so many of four renders that were localized."""
    lost = CertifiedPhoto("render 4", "no matches", None, None, 20.0, 20.0, 0.9)
    good = CertifiedPhoto("render 1", None, distance, 0.01, 20.0, 20.0, 0.9)
    photos = (good,) * found + (lost,) * (4 - found)
    return Certificate(photos, 4.0, 1.0, 12, 100, CertificateSettings(), of_renders=True)


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize(
    "certificate, status, said",
    [
        (certificate_of(4, 0.002), 0, "The map is good: 4 of the 4 renders"),
        (certificate_of(3, 0.002), 0, "The map is usable: 3 of the 4 renders"),
        (certificate_of(1, 0.002), 4, "The map is poor: 1 of the 4 renders"),
        (certificate_of(4, 0.3), 4, "Do not rely on it"),
    ],
)
def test_a_poor_map_is_written_but_said_to_be_poor(
    certificate: Certificate,
    status: int,
    said: str,
    splat: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def certify(map_: Map, **_: object) -> Certificate:
        assert map_.references.virtual
        return certificate

    monkeypatch.setattr(build_map_alone, "certify_virtual", certify)
    output = tmp_path / "m.gsmap"
    command = ["build-map", str(splat), "--virtual-references", "--camera", CAMERA, "--up=0,0,1"]
    assert main([*command, "--output", str(output)]) == status
    printed = capsys.readouterr()
    assert said in (printed.out if certificate.verdict == "good" else printed.err)
    assert ("no matches" in printed.err) == (certificate.localized < 1)
    assert read_certificate(output) == certificate


@pytest.mark.parametrize(
    "options, said",
    [
        (["--virtual-references", "--colmap", "model", "--images", "photos"], "--colmap and"),
        (["--virtual-references", "--no-references"], "not allowed with"),
        (["--virtual-references", "--up", "1,2"], "three numbers"),
        (["--virtual-references", "--up", "a,b,c"], "three numbers"),
        (["--virtual-references", "--up", "0,0,0"], "up must be a direction"),
        (["--virtual-references", "--fit"], "--fit and --transform"),
        (["--no-references", "--up", "0,0,1"], "go with --virtual-references"),
        (["--virtual-references", "--camera", "PINHOLE,1"], "camera"),
        (["--virtual-references", "--camera", "PINHOLE,8,8,6,6,4,4"], "8x8 pixels are too small"),
        (["--virtual-references", "--camera", "SIMPLE_RADIAL,640,480,500,320,240,0.1"], "pinhole"),
    ],
)
def test_what_does_not_go_together_is_said(
    splat: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    said: str,
) -> None:
    output = tmp_path / "m.gsmap"
    try:
        status = main(["build-map", str(splat), *options, "--output", str(output)])
    except SystemExit as error:
        status = int(str(error.code))
    assert status == 2
    assert said in capsys.readouterr().err
    assert not output.exists()
