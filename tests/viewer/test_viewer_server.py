# SPDX-License-Identifier: Apache-2.0
"""The server without a browser: where it listens, and that it does nothing else."""

from __future__ import annotations

import sys
import urllib.request
from pathlib import Path

import pytest
from scenes import room_map

from gscpe.cli.main import main
from gscpe.errors import OutputError
from gscpe.scene import save_map
from gscpe.viewer import Viewer, contents_of
from gscpe.viewer.server import page_url


def test_it_is_local_quiet_and_not_shared(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    contents = contents_of(room_map())
    with Viewer(room_map(), contents, most_gaussians=100) as viewer:
        assert viewer.url.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(viewer.url, timeout=60) as answer:
            assert b"<html" in answer.read(1000)
        assert viewer._server.request_share_url() is None
        port = viewer._server.get_port()
        with pytest.raises(OutputError, match="in use"):
            Viewer(room_map(), contents, port=port, most_gaussians=100)
    assert capsys.readouterr() == ("", "")


def test_an_address_of_another_machine_is_refused() -> None:
    """viser would wait for ever."""
    pytest.importorskip("viser")
    contents = contents_of(room_map())
    for port in (None, 8080):
        with pytest.raises(OutputError, match=r"no page can be served at 192\.0\.2\.1"):
            Viewer(room_map(), contents, host="192.0.2.1", port=port, most_gaussians=100)


def test_addresses_of_the_page() -> None:
    assert page_url("127.0.0.1", 80) == "http://127.0.0.1:80"
    assert page_url("::1", 8080) == "http://[::1]:8080"
    assert page_url("0.0.0.0", 8080) == page_url("::", 8080) == "http://localhost:8080"


def test_viser_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save_map(room_map(), tmp_path / "room.gsmap")
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", str(tmp_path / "room.gsmap"), "--no-open"]) == 2
    assert "pip install 'gscpe[view]'" in capsys.readouterr().err
