# SPDX-License-Identifier: Apache-2.0
"""A real Dask cluster on this machine: as one process would, whoever is killed meanwhile."""

from __future__ import annotations

import os
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Iterator

import pytest
from batch_room import CAMERA, QUERIES, TRAP, RoomFolder, make_room, run, wait_until

from gscpe.batch import make_crew, read_details
from gscpe.cli.main import main
from gscpe.errors import MapError, MissingDependencyError, SettingsError, WorkerError

pytest.importorskip("distributed", reason="Dask is not installed (pip install 'gscpe[dask]')")

from gscpe.batch.dask_crew import DaskCrew, LocalizerPlugin

needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")


@pytest.fixture(scope="module")
def room_folder(tmp_path_factory: pytest.TempPathFactory) -> RoomFolder:
    return make_room(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=":0",
        local_directory=str(tmp_path_factory.mktemp("dask")),
        silence_logs="CRITICAL",
    ) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def crew(cluster: Any, room_folder: RoomFolder) -> Iterator[DaskCrew]:
    with make_crew(room_folder.instructions, scheduler=cluster.scheduler_address) as crew:
        assert isinstance(crew, DaskCrew)
        yield crew


def kill_at_the_trap(cluster: Any, disarm: RoomFolder | None = None) -> None:
    """Waits until the first query of a list is worked on, and kills the worker."""

    def trapped() -> int | None:
        for worker in cluster.scheduler.workers.copy().values():
            if any(str(task.key).endswith("-0") for task in worker.processing):
                return int(worker.pid)
        return None

    pid = wait_until(trapped)
    if disarm is not None:
        disarm.disarm()
    os.kill(pid, signal.SIGKILL)


def test_as_in_one_process(crew: DaskCrew, room_folder: RoomFolder) -> None:
    """To the last digit, and photos that cannot be used fail alike."""
    details = run(crew, QUERIES)
    assert details == {query.name: room_folder.expected[query.name] for query in QUERIES}
    assert crew.description.startswith("2 Dask workers at tcp://")
    assert run(crew, ()) == {}


@needs_pipes
def test_a_killed_workers_query_is_run_elsewhere(
    crew: DaskCrew, cluster: Any, room_folder: RoomFolder
) -> None:
    expected = room_folder.expected
    room_folder.set_trap()
    with ThreadPoolExecutor(1) as pool:
        killer = pool.submit(kill_at_the_trap, cluster, room_folder)
        assert run(crew, (TRAP, *QUERIES)) == expected
        killer.result()


@needs_pipes
def test_a_query_that_kills_its_workers_fails_alone(
    crew: DaskCrew, cluster: Any, room_folder: RoomFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second list is done by workers that joined after the crew was made."""
    expected = room_folder.expected
    monkeypatch.setattr(cluster.scheduler, "allowed_failures", 0)
    room_folder.set_trap()
    with ThreadPoolExecutor(1) as pool:
        killer = pool.submit(kill_at_the_trap, cluster)
        (detail,) = run(crew, (TRAP,)).values()
        killer.result()
    assert detail["status"] == "failed"
    assert "its Dask workers died repeatedly" in detail["reason"]
    assert detail.keys() == expected[TRAP.name].keys()
    room_folder.disarm()
    wait_until(lambda: len(cluster.scheduler.workers) == 2)
    assert run(crew, (TRAP, *QUERIES)) == expected


@needs_pipes
def test_a_worker_that_hangs_begins_anew(room_folder: RoomFolder) -> None:
    """In a new thread, with the map opened again; the photo has failed."""
    expected = room_folder.expected
    plugin = LocalizerPlugin("here", room_folder.instructions)
    dask_worker: Any = SimpleNamespace(address="here", state=SimpleNamespace(nthreads=1))
    plugin.setup(dask_worker)
    assert "threads" in plugin.description()
    patient = plugin._instructions
    plugin._instructions = replace(patient, timeout=0.3)  # for the trap alone
    room_folder.set_trap()
    hung = plugin.localize(TRAP)
    plugin._instructions = patient
    assert (hung["status"], hung["reason"]) == ("failed", "its worker hung (no answer for 0.3 s)")
    detail = plugin.localize(QUERIES[0])
    assert detail["cam_from_world"] == expected[QUERIES[0].name]["cam_from_world"]
    os.close(os.open(room_folder.path / "photos" / TRAP.name, os.O_WRONLY))  # the hang ends
    plugin.teardown(dask_worker)


def test_the_command_line(
    cluster: Any, room_folder: RoomFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And the map is closed on the workers afterwards."""
    before = set(cluster.scheduler.worker_plugins)
    text = "".join(f"{query.name} {CAMERA.colmap_text()}\n" for query in QUERIES)
    (tmp_path / "queries.txt").write_text(text)
    status = main(
        [
            *("localize", str(room_folder.path / "room.gsmap"), "--matcher", "sift"),
            *("--queries", str(tmp_path / "queries.txt"), "--output", str(tmp_path / "poses.txt")),
            *("--images", str(room_folder.path / "photos")),
            *("--scheduler", cluster.scheduler_address),
        ]
    )
    assert status == 0
    assert capsys.readouterr().out.startswith("3 of 4 photos localized")
    for name, detail in read_details(tmp_path / "poses.details.jsonl").items():
        assert detail["cam_from_world"] == room_folder.expected[name]["cam_from_world"]
    assert set(cluster.scheduler.worker_plugins) == before


def test_folders_that_the_workers_do_not_see(cluster: Any, room_folder: RoomFolder) -> None:
    elsewhere = replace(room_folder.instructions, image_folder=Path("/nowhere/photos"))
    with pytest.raises(MapError, match=r"no folder /nowhere/photos on the Dask worker.*shared"):
        make_crew(elsewhere, scheduler=cluster.scheduler_address)


def test_a_workers_start_raises_here_what_it_raised_there(
    cluster: Any, room_folder: RoomFolder
) -> None:
    instructions = room_folder.instructions
    old = replace(instructions.fingerprint, map="0" * 12)
    with pytest.raises(MapError, match="has changed since"):
        make_crew(replace(instructions, fingerprint=old), scheduler=cluster.scheduler_address)


def test_schedulers_that_are_none(room_folder: RoomFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    import dask
    from distributed import LocalCluster

    with pytest.raises(SettingsError, match="--scheduler pigeon://here"):
        make_crew(room_folder.instructions, scheduler="pigeon://here")
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "0.3s"}),
        pytest.raises(WorkerError, match=r"127\.0\.0\.1:1 cannot be reached"),
    ):
        make_crew(room_folder.instructions, scheduler="tcp://127.0.0.1:1")
    monkeypatch.setattr("gscpe.batch.dask_crew._PATIENCE", 0.3)
    with (
        LocalCluster(n_workers=0, dashboard_address=":0") as empty,
        pytest.raises(WorkerError, match="has had no workers"),
    ):
        make_crew(room_folder.instructions, scheduler=empty.scheduler_address)


def test_a_scheduler_that_ends_under_way(room_folder: RoomFolder) -> None:
    """An error, and no waiting for ever."""
    import dask
    from distributed import LocalCluster

    with (
        dask.config.set({"distributed.comm.timeouts.connect": "0.5s"}),
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
        ) as brief,
        make_crew(room_folder.instructions, scheduler=brief.scheduler_address) as crew,
    ):
        finished = crew.run(QUERIES * 4)
        next(finished)
        brief.close()
        with pytest.raises(WorkerError):
            list(finished)


def test_without_dask(room_folder: RoomFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"gscpe\[dask\]"):
        make_crew(room_folder.instructions, scheduler="tcp://127.0.0.1:8786")
