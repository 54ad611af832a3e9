# SPDX-License-Identifier: Apache-2.0
"""Workers in processes: as one process would, whoever is killed meanwhile."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Iterator

import pytest
from batch_room import CAMERA, QUERIES, TRAP, RoomFolder, make_room, run, wait_until

from gscpe.batch import make_crew, read_details
from gscpe.batch.process_crew import ProcessCrew
from gscpe.cli.main import main
from gscpe.errors import MapError, ModelError, SettingsError, WorkerError
from gscpe.poses.hloc import read_poses

needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")


@pytest.fixture(scope="module")
def room_folder(tmp_path_factory: pytest.TempPathFactory) -> RoomFolder:
    return make_room(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="module")
def crew(room_folder: RoomFolder) -> Iterator[ProcessCrew]:
    with make_crew(room_folder.instructions, workers=2) as crew:
        assert isinstance(crew, ProcessCrew)
        yield crew


def kill_at_the_trap(crew: ProcessCrew, before: int = 0) -> int:
    """Waits until a worker, another one than before, is in the trap, and kills it."""

    def trapped() -> int | None:
        names = {name: pid for pid, name in crew.at_work().items() if pid != before}
        return names.get(TRAP.name)

    pid = int(wait_until(trapped))
    os.kill(pid, signal.SIGKILL)
    return pid


def test_as_in_one_process(crew: ProcessCrew, room_folder: RoomFolder) -> None:
    """To the last digit, and photos that cannot be used fail alike."""
    details = run(crew, QUERIES)
    assert details == {query.name: room_folder.expected[query.name] for query in QUERIES}
    assert [details[q.name]["status"] for q in QUERIES] == ["localized"] * 3 + ["failed"]
    assert crew.description.startswith("2 processes, each: ")


@needs_pipes
def test_a_killed_workers_query_is_tried_again(crew: ProcessCrew, room_folder: RoomFolder) -> None:
    expected = room_folder.expected
    room_folder.set_trap()

    def kill() -> None:
        pid = wait_until(lambda: {name: pid for pid, name in crew.at_work().items()}.get(TRAP.name))
        room_folder.disarm()
        os.kill(pid, signal.SIGKILL)

    with ThreadPoolExecutor(1) as pool:
        killer = pool.submit(kill)
        assert run(crew, (TRAP, *QUERIES)) == expected
        killer.result()


@needs_pipes
def test_a_query_that_kills_its_workers_fails_alone(
    crew: ProcessCrew, room_folder: RoomFolder
) -> None:
    expected = room_folder.expected
    room_folder.set_trap()
    with ThreadPoolExecutor(1) as pool:
        killer = pool.submit(lambda: kill_at_the_trap(crew, kill_at_the_trap(crew)))
        details = run(crew, (TRAP, *QUERIES))
        killer.result()
    killed = details.pop(TRAP.name)
    assert killed["status"] == "failed"
    assert "its worker died, 2 times (SIGKILL; out of memory?)" in killed["reason"]
    assert killed.keys() == expected[TRAP.name].keys()
    assert details == {query.name: expected[query.name] for query in QUERIES}


@needs_pipes
def test_a_worker_that_hangs_is_replaced(room_folder: RoomFolder) -> None:
    """And its photo has failed, at once: it would hang the next one too."""
    expected = room_folder.expected
    with ProcessCrew(room_folder.instructions, 1) as crew:
        crew._pool.workers[0].timeout = 0.5  # of this one alone: a busy machine may be slow
        room_folder.set_trap()
        details = run(crew, (TRAP, *QUERIES[:2]))
    hung = details.pop(TRAP.name)
    assert hung["status"] == "failed"
    assert hung["reason"] == "its worker hung (no answer for 0.5 s)"
    assert hung.keys() == expected[TRAP.name].keys()
    assert details == {query.name: expected[query.name] for query in QUERIES[:2]}


def test_an_idle_worker_that_was_killed(crew: ProcessCrew, room_folder: RoomFolder) -> None:
    for process in multiprocessing.active_children()[:1]:
        process.kill()
        process.join()
    details = run(crew, QUERIES[:2])
    assert details == {query.name: room_folder.expected[query.name] for query in QUERIES[:2]}


def test_nothing_to_do(crew: ProcessCrew) -> None:
    assert run(crew, ()) == {}


def test_closing_ends_the_processes(room_folder: RoomFolder) -> None:
    before = set(multiprocessing.active_children())
    with ProcessCrew(room_folder.instructions, 1):
        assert len(set(multiprocessing.active_children()) - before) == 1
    assert set(multiprocessing.active_children()) <= before


def test_a_workers_start_raises_here_what_it_raised_there(
    tmp_path: Path, room_folder: RoomFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    instructions, before = room_folder.instructions, set(multiprocessing.active_children())
    monkeypatch.setenv("GSCPE_MODELS", str(tmp_path))
    with pytest.raises(ModelError, match=r"xfeat\.onnx is missing"):
        ProcessCrew(replace(instructions, matcher="xfeat"), 2)
    damaged = tmp_path / "damaged.gsmap"
    damaged.mkdir()
    (damaged / "map.json").write_bytes((instructions.map_folder / "map.json").read_bytes())
    with pytest.raises(MapError, match=r"gaussians\.npz cannot be read"):
        ProcessCrew(replace(instructions, map_folder=damaged), 2)
    assert set(multiprocessing.active_children()) <= before


def test_a_worker_refuses_a_map_that_was_built_anew(room_folder: RoomFolder) -> None:
    instructions = room_folder.instructions
    old = replace(instructions.fingerprint, map="0" * 12)
    with pytest.raises(MapError, match="has changed since"):
        ProcessCrew(replace(instructions, fingerprint=old), 1)


def test_workers_that_die_at_once(
    tmp_path: Path, room_folder: RoomFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error, and not an endless row of them."""
    (tmp_path / "sitecustomize.py").write_text("import os; os.kill(os.getpid(), 9)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(WorkerError, match=r"die while starting \(SIGKILL; out of memory"):
        ProcessCrew(room_folder.instructions, 2)


def test_workers_that_hang_at_once(
    tmp_path: Path, room_folder: RoomFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text("import time; time.sleep(1000)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(WorkerError, match=r"die while starting \(no answer for 0.5 s\)"):
        ProcessCrew(replace(room_folder.instructions, timeout=0.5), 1)


def test_no_workers(room_folder: RoomFolder) -> None:
    with pytest.raises(SettingsError, match="at least one worker"):
        make_crew(room_folder.instructions, workers=0)
    with pytest.raises(SystemExit):
        main(["localize", "map", "--workers", "0"])
    with pytest.raises(SystemExit):
        main(["localize", "map", "--workers", "2", "--scheduler", "tcp://here:1"])


@needs_pipes
@pytest.mark.parametrize(
    ("number", "workers", "status"),
    [(signal.SIGINT, "2", 130), (signal.SIGTERM, "2", 143), (signal.SIGTERM, "1", 143)],
)
def test_interrupted_and_resumed(
    number: signal.Signals,
    workers: str,
    status: int,
    room_folder: RoomFolder,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Ctrl-C reaches all processes of a terminal, SIGTERM often all of a job: none of them
    complains, all of them end."""
    expected = room_folder.expected
    room_folder.set_trap()
    poses, details = tmp_path / "poses.txt", tmp_path / "poses.details.jsonl"
    queries = [*QUERIES[:3], TRAP]
    text = "".join(f"{query.name} {CAMERA.colmap_text()}\n" for query in queries)
    (tmp_path / "queries.txt").write_text(text)
    arguments = [
        *("localize", str(room_folder.path / "room.gsmap"), "--matcher", "sift"),
        *("--queries", str(tmp_path / "queries.txt"), "--output", str(poses)),
        *("--images", str(room_folder.path / "photos"), "--workers", workers),
    ]
    # A background job of a script has Ctrl-C ignored, and its children inherit that.
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from gscpe.cli import main; sys.exit(main())"
    )
    command = subprocess.Popen(
        [sys.executable, "-c", program, *arguments],
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_until(lambda: len(read_details(details)) == 3)
    os.killpg(command.pid, number)
    out, err = command.communicate(timeout=60)  # ends when no process holds the pipe
    assert (command.returncode, out) == (status, "")
    said = "interrupted" if status == 130 else "ended by SIGTERM"
    assert [line for line in err.splitlines() if "OpenGL" not in line] == [
        "gscpe.batch.to_files: 3 of 4 photos are finished; run the same again with resume "
        "(--resume) to continue",
        f"gscpe localize: {said}",
    ]
    assert list(read_poses(poses)) == ["a.png", "b.png", "c.png"]
    if (number, workers) != (signal.SIGINT, "2"):
        return

    room_folder.disarm()
    before = details.read_text()
    assert main([*arguments[:-1], "1", "--resume"]) == 0
    assert capsys.readouterr().out.startswith("4 of 4 photos localized")
    after = read_details(details)
    assert sorted(details.read_text().splitlines()[:3]) == sorted(before.splitlines())
    for name, detail in after.items():
        assert detail["cam_from_world"] == expected[name]["cam_from_world"]
    assert list(read_poses(poses)) == [query.name for query in queries]  # as in the list
