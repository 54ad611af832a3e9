# SPDX-License-Identifier: Apache-2.0
"""Matchers by name, in the library and on the command line."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np
import pytest
from scenes import room_map

from gscpe import Localizer
from gscpe.cli.common import add_matcher
from gscpe.cli.main import main
from gscpe.errors import ModelError, SettingsError
from gscpe.matching import (
    MATCHERS,
    LighterGlueMatcher,
    Matcher,
    SiftMatcher,
    XFeatMatcher,
    make_matcher,
)
from gscpe.models import InstalledFile, installed_files
from gscpe.photos import write_image
from gscpe.scene import save_map


def with_states(monkeypatch: pytest.MonkeyPatch, **states: str) -> None:
    """As if the networks were installed, and could be opened."""
    files = tuple(InstalledFile("xfeat", Path(f"{n}.onnx"), 1, s) for n, s in states.items())
    monkeypatch.setattr("gscpe.matching.choose.installed_files", lambda model: files)
    monkeypatch.setattr("gscpe.matching.xfeat_matcher.XFeat", object)
    monkeypatch.setattr("gscpe.matching.lighterglue_matcher.XFeat", object)
    monkeypatch.setattr("gscpe.matching.lighterglue_matcher.LighterGlue", object)


@pytest.fixture
def nothing_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path / "none"))


@pytest.mark.usefixtures("nothing_installed")
def test_without_models(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="gscpe"):
        assert type(make_matcher()) is type(make_matcher("auto")) is SiftMatcher
    assert "matched by sift" in caplog.text
    assert isinstance(make_matcher("sift"), SiftMatcher)
    for name in ("xfeat", "xfeat+lighterglue"):
        with pytest.raises(ModelError, match=r"xfeat\.onnx is missing.*gscpe models install xfeat"):
            make_matcher(name)


def test_with_models(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    with_states(monkeypatch, xfeat="ok", lighterglue="ok")
    with caplog.at_level(logging.INFO, logger="gscpe"):
        assert isinstance(make_matcher(), XFeatMatcher)
    assert "matched by xfeat" in caplog.text
    assert isinstance(make_matcher("xfeat"), XFeatMatcher)
    assert isinstance(make_matcher("xfeat+lighterglue"), LighterGlueMatcher)
    assert isinstance(make_matcher("sift"), SiftMatcher)


@pytest.mark.parametrize("state", ["damaged", "outdated"])
def test_damaged_models_are_not_passed_over(state: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with_states(monkeypatch, xfeat=state, lighterglue="ok")
    for name in ("auto", "xfeat", "xfeat+lighterglue"):
        with pytest.raises(ModelError, match=rf"xfeat\.onnx is {state}; install it again"):
            make_matcher(name)
    assert isinstance(make_matcher("sift"), SiftMatcher)
    with_states(monkeypatch, xfeat="ok", lighterglue=state)
    assert isinstance(make_matcher(), XFeatMatcher)
    with pytest.raises(ModelError, match=rf"lighterglue\.onnx is {state}"):
        make_matcher("xfeat+lighterglue")


@pytest.mark.parametrize("name", ["", "SIFT", "superglue", "onnx", "onnx:", "xfeat+", " sift"])
def test_unknown_names(name: str) -> None:
    with pytest.raises(SettingsError, match="there is no matcher") as caught:
        make_matcher(name)
    assert all(known in str(caught.value) for known in MATCHERS)
    with pytest.raises(SettingsError, match="there is no matcher"):
        Localizer(room_map(), matcher=name)


def test_a_missing_onnx_file(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"none\.onnx is missing, or no file; give the path"):
        make_matcher(f"onnx:{tmp_path / 'none.onnx'}")


@pytest.mark.usefixtures("nothing_installed")
@pytest.mark.parametrize("matcher", [None, "auto", "sift", SiftMatcher()])
def test_what_a_localizer_takes(matcher: Matcher | str | None) -> None:
    with Localizer(room_map(), matcher=matcher, backend="cpu") as localizer:
        assert isinstance(localizer._matcher, SiftMatcher)


def test_the_installed_networks_match() -> None:
    if any(file.state != "ok" for file in installed_files("xfeat")):
        pytest.skip("XFeat is not installed (gscpe models install xfeat)")
    assert isinstance(make_matcher(), XFeatMatcher)
    assert isinstance(make_matcher("xfeat+lighterglue"), LighterGlueMatcher)


def test_the_option() -> None:
    parser = argparse.ArgumentParser()
    add_matcher(parser)
    assert parser.parse_args([]).matcher == "auto"
    assert parser.parse_args(["--matcher", "onnx:a.onnx"]).matcher == "onnx:a.onnx"


@pytest.mark.parametrize("command", ["demo", "localize"])
def test_commands_hand_the_name_on(
    command: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    """An unknown one is refused, with the choices."""
    monkeypatch.chdir(tmp_path)
    arguments = [command, "--matcher", "superglue"]
    if command == "localize":
        camera = "PINHOLE,24,18,20,20,12,9"
        save_map(room_map(), tmp_path / "map")
        write_image(tmp_path / "photo.png", np.zeros((18, 24, 3), np.uint8))
        arguments += ["map", "photo.png", "--camera", camera]
    assert main(arguments) != 0
    assert "there is no matcher 'superglue'; choose one of auto, sift" in capsys.readouterr().err
