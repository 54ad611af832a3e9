# SPDX-License-Identifier: Apache-2.0
"""Clients that leave, workers that are killed, a server that is ended."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Callable

import pytest
from batch_room import RoomFolder, wait_until
from serving import Serving, photo_of, post, serving

from gscpe.cli.main import main
from gscpe.service.service import Service

httpx = pytest.importorskip("httpx")


def test_a_client_that_leaves_frees_its_worker(
    fake: Callable[..., Service], tmp_path: Path
) -> None:
    with serving(fake()) as one:
        address, files = f"{one.url}/v1/maps/room/localize", {"photo": f"wait {tmp_path / 'f'}"}
        with pytest.raises(httpx.ReadTimeout):
            httpx.post(address, files=files, timeout=httpx.Timeout(60, read=1.0))
        wait_until((tmp_path / "f.stopped").exists)
        assert post(one.url, b"echo on").json()["text"] == "on"
        assert one.service.metrics.replaced == 0
        wait_until(lambda: one.service.gate.inside == 0)


def test_a_client_that_leaves_while_it_sends(
    fake: Callable[..., Service], caplog: pytest.LogCaptureFixture
) -> None:
    route = 'gscpe_requests_total{route="/v1/maps/{map_name}/localize"'
    with serving(fake()) as one:
        where = httpx.URL(one.url)
        with socket.create_connection((where.host, where.port)) as connection:
            connection.sendall(
                b"POST /v1/maps/room/localize HTTP/1.1\r\nHost: localhost\r\n"
                b"Content-Type: multipart/form-data; boundary=x\r\nContent-Length: 500000\r\n\r\n"
                b'--x\r\nContent-Disposition: form-data; name="photo"; filename="a.jpg"\r\n\r\n0'
            )
            wait_until(lambda: one.service.gate.inside == 1)
        wait_until(lambda: route in one.service.metrics_text())
        assert f'{route},status="499"}} 1' in one.service.metrics_text()
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]


def test_a_worker_that_is_killed_at_work(server: Serving, room: RoomFolder) -> None:
    """Its photo is answered all the same."""
    before = server.service.staff.pids()
    with ThreadPoolExecutor(12) as pool:
        answers = [pool.submit(post, server.url, photo_of(room)) for _ in range(12)]
        busy = wait_until(lambda: [p for p, name in server.service.staff.pids().items() if name])
        os.kill(busy[0], signal.SIGKILL)
        statuses = [answer.result().json()["status"] for answer in answers]
    assert statuses == ["localized"] * 12
    wait_until(lambda: server.service.staff.alive == 2)
    assert set(server.service.staff.pids()) != set(before)


def test_sigterm_finishes_what_is_running(room: RoomFolder, tmp_path: Path) -> None:
    arguments = ["serve", str(room.path / "room.gsmap"), "--port", "0", "--workers", "1"]
    command = subprocess.Popen(
        [sys.executable, "-m", "gscpe", *arguments, "--matcher", "sift"],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert command.stderr is not None
    line = command.stderr.readline()
    while not line.startswith("gscpe serve: http"):
        assert line, "it ended"
        line = command.stderr.readline()
    url = line.split()[2].rstrip(",")
    answers: list[Any] = []
    threads = [
        threading.Thread(target=lambda: answers.append(post(url, photo_of(room)))) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    wait_until(lambda: httpx.get(f"{url}/health").json()["waiting"] >= 2)
    command.send_signal(signal.SIGTERM)
    for thread in threads:
        thread.join()
    assert [answer.json()["status"] for answer in answers] == ["localized"] * 4
    assert command.wait(60) == 0
    assert command.stderr.read().strip() == "gscpe serve: ended"


def test_what_the_command_line_refuses(
    room: RoomFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    map_ = str(room.path / "room.gsmap")

    def refused(*arguments: str) -> str:
        assert main(["serve", "--port", "0", *arguments]) == 2
        return capsys.readouterr().err

    assert "--token-file" in refused(map_, "--host", "0.0.0.0")
    assert "cannot be read" in refused(map_, "--token-file", str(tmp_path / "no"))
    assert "is given twice" in refused(map_, map_)
    odd = tmp_path / "it's @ home.gsmap"
    shutil.copytree(map_, odd)
    assert "that an address cannot have" in refused(str(odd))
    assert "it has no map.json" in refused(str(tmp_path))
    assert "together" in refused(map_, "--key", "k.pem")
    assert "cannot listen" in refused(map_, "--host", "203.0.113.1", "--insecure")
