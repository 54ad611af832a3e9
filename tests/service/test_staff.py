# SPDX-License-Identifier: Apache-2.0
"""Workers of a service, whoever dies, hangs or is not waited for any more."""

from __future__ import annotations

import logging
import os
import signal
from concurrent.futures import CancelledError
from multiprocessing import Pipe
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest
from batch_room import CAMERA, RoomFolder, wait_until
from fake_desk import FakeDesk, Stillborn, job

from gscpe.batch import shelf_order
from gscpe.batch.in_process import Stop, StoppedError, Talk
from gscpe.batch.shelf import Shelf
from gscpe.errors import WorkerError
from gscpe.service.desk import Desk, LocalizeJob
from gscpe.service.limits import Limits
from gscpe.service.metrics import Metrics
from gscpe.service.problem import Problem
from gscpe.service.staff import Staff


@pytest.fixture(scope="module")
def staff() -> Iterator[Staff]:
    with Staff(FakeDesk.start, 2, 1, Limits(), Metrics()) as staff:
        yield staff


def answer(staff: Staff, says: str) -> Any:
    return staff.submit(job(says)).future.result(120)


def test_each_gets_its_own_answer(staff: Staff) -> None:
    tickets = [staff.submit(job(f"echo {n}")) for n in range(50)]
    assert [t.future.result(120)["text"] for t in tickets] == [str(n) for n in range(50)]
    assert (staff.waiting, staff.busy) == (0, 0)
    assert staff.description == "2 processes, each: nothing"
    assert answer(staff, "refuse a.jpg is bad") == Problem(422, "PhotoError", "a.jpg is bad")


def test_a_killed_workers_job_is_tried_once_more(staff: Staff, tmp_path: Path) -> None:
    assert answer(staff, f"die {tmp_path / 'flag'}")["text"] == "again"
    killed = answer(staff, "die")
    assert killed == Problem(500, "WorkerError", "its worker died, 2 times")
    broken = answer(staff, "fail /secret/path")
    assert broken == Problem(500, "WorkerError", "its worker died, 2 times")
    assert answer(staff, "echo on")["text"] == "on"


def test_a_job_that_is_called_off_frees_its_worker(staff: Staff, tmp_path: Path) -> None:
    flags = [str(tmp_path / name) for name in "ab"]
    working = [staff.submit(job(f"wait {flag}")) for flag in flags]
    wait_until(lambda: all(Path(f"{flag}.begun").exists() for flag in flags))
    waiting = staff.submit(job("echo never"))
    staff.call_off(waiting)
    with pytest.raises(CancelledError):
        waiting.future.result(60)
    pids = set(staff.pids())
    staff.call_off(working[0])
    wait_until(lambda: Path(f"{flags[0]}.stopped").exists())
    assert answer(staff, "echo next")["pid"] in pids  # not a new one
    Path(flags[1]).touch()
    assert working[1].future.result(60)["text"] == "waited"
    assert set(staff.pids()) == pids


@pytest.mark.parametrize("at_work", [False, True])
def test_who_leaves_is_no_failure(
    room: RoomFolder,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    at_work: bool,
) -> None:
    """Whether the photo has just been decoded, or is being localized."""
    ours, theirs = Pipe()
    photo = (room.path / "photos" / "a.png").read_bytes()
    order = shelf_order([str(room.path / "room.gsmap")], matcher="sift")
    if at_work:
        monkeypatch.setattr(Shelf, "localizer", _telling(Shelf.localizer, ours))
    else:
        ours.send(Stop())
    with (
        Desk(Shelf(order), "") as desk,
        caplog.at_level(logging.DEBUG, "gscpe.service"),
        pytest.raises(StoppedError),
    ):
        desk.work(LocalizeJob("room", photo, "a.png", CAMERA, None), Talk(theirs))
    assert caplog.records == []


def _telling(localizer: Callable[..., Any], pipe: Any) -> Callable[..., Any]:
    def told(shelf: Shelf, name: str) -> Any:
        pipe.send(Stop())
        return localizer(shelf, name)

    return told


def test_a_worker_that_hangs() -> None:
    limits = Limits(seconds=30.0, decode_seconds=30.0)
    with Staff(FakeDesk.start, 1, 1, limits, Metrics()) as staff:
        answer(staff, "echo ready")
        assert staff.description == "1 process: nothing"
        staff._limits = Limits(seconds=0.3, decode_seconds=30.0)
        stuck = answer(staff, "hang")
        assert stuck == Problem(504, "TooSlow", "its worker hung, 2 times (no answer for 0.3 s)")
        staff._limits = Limits(seconds=30.0, decode_seconds=0.3)
        bomb = answer(staff, "slow-decode")
        assert (bomb.status, bomb.error) == (422, "TooSlow")
        assert "takes more than 0.3 s to decode" in bomb.detail
        staff._limits = Limits(seconds=1.0, decode_seconds=30.0)
        assert answer(staff, "toil 2.5")["text"] == "done"  # who is slow does not hang
        staff._limits = limits
        assert answer(staff, "echo on")["text"] == "on"
        assert staff._metrics.replaced == 3


def test_an_idle_worker_that_hangs() -> None:
    """It does not even take a large job out of the pipe; another one does."""
    with Staff(FakeDesk.start, 1, 1, Limits(), Metrics()) as staff:
        answer(staff, "echo ready")
        (pid,) = staff.pids()
        os.kill(pid, signal.SIGSTOP)
        staff._limits = Limits(seconds=0.5)
        first = staff.submit(job("echo " + "x" * 3_000_000))
        wait_until(lambda: pid not in staff.pids())
        staff._limits = Limits()
        assert len(first.future.result(120)["text"]) == 3_000_000


def test_closing_answers_who_waits(tmp_path: Path) -> None:
    staff = Staff(FakeDesk.start, 1, 1, Limits(), Metrics())
    begun = staff.submit(job(f"wait {tmp_path / 'a'}"))
    queued = staff.submit(job("echo a"))
    wait_until((tmp_path / "a.begun").exists)
    staff.close()
    assert begun.future.result(0).status == queued.future.result(0).status == 503
    assert staff.submit(job("echo late")).future.result(0).status == 503


def test_workers_that_never_start() -> None:
    with pytest.raises(WorkerError, match="die while starting"):
        Staff(Stillborn.start, 1, 1, Limits(), Metrics())
