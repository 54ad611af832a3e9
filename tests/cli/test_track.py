# SPDX-License-Identifier: Apache-2.0
"""``gscpe track``: sequences in, trajectories out."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import Messages, write_bag
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import Camera, Tracker, pose_difference
from gscpe.cli.main import main
from gscpe.geometry import se3
from gscpe.photos import read_image, write_image
from gscpe.poses import read_pose_file
from gscpe.poses.tum import tum_line
from gscpe.scene import save_map
from gscpe.tracking import Motion, TrackingResult

CAMERA = room_camera(240, 180)
CAMERA_WORDS = CAMERA.colmap_text().replace(" ", ",")
COUNT = 6
STEP = np.array([0.006, -0.003, 0.004, 0.002, 0.004, -0.003])
TIMES = [f"{10 + i / 10:.1f}" for i in range(COUNT)]
POSES = {time: se3.exp(i * STEP) @ ROOM_POSE for i, time in enumerate(TIMES)}

TALLY = re.compile(
    r"(\d+) frames: (\d+) tracked, (\d+) relocalized, (\d+) lost, (\d+) dropped(?:, (\d+) "
    r"unreadable)?(?:; [\d.]+ frames a second, median \d+ ms, worst \d+ ms)?"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """room.gsmap, and walk/, photos that are named by their times."""
    folder = tmp_path_factory.mktemp("track")
    save_map(room_map(), folder / "room.gsmap")
    for time, pose in POSES.items():
        write_image(folder / "walk" / f"{time}.png", room().shoot(CAMERA, pose).uint8)
    return folder


def track(folder: Path, source: Path | str, output: Path, *more: str) -> int:
    words = ["track", str(folder / "room.gsmap"), str(source), "--output", str(output)]
    return main([*words, "--matcher", "sift", *more])


def counts(out: str) -> list[int]:
    """Frames, tracked, relocalized, lost, dropped, unreadable."""
    found = TALLY.fullmatch(out.splitlines()[0])
    assert found is not None, out
    return [int(number or 0) for number in found.groups()]


def check(poses: dict[str, NDArray[np.float64]], distance: float = 0.01) -> None:
    for name, pose in poses.items():
        error = pose_difference(pose, POSES[name.removesuffix(".png")])
        assert error.distance < distance
        assert error.degrees < 0.3


def test_a_folder(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output, poses = tmp_path / "new" / "walk.tum", tmp_path / "poses.txt"
    more = ["--camera", CAMERA_WORDS, "--poses", str(poses)]
    assert track(folder, folder / "walk", output, *more) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert counts(out) == [COUNT, COUNT - 1, 1, 0, 0, 0]
    details = output.with_suffix(".details.jsonl")
    assert out.splitlines()[1:] == [f"{output}: {COUNT} poses; details: {details}"]
    trajectory, hloc = read_pose_file(output), read_pose_file(poses)
    assert (trajectory.format, list(trajectory.poses)) == ("tum", [*map(stamp, TIMES)])
    assert list(hloc.poses) == [f"{time}.png" for time in TIMES]
    check({time: trajectory.poses[stamp(time)] for time in TIMES})
    check(hloc.poses)
    lines = [json.loads(line) for line in details.read_text().splitlines()]
    assert [line["status"] for line in lines] == ["relocalized", *["tracking"] * (COUNT - 1)]
    assert all(np.linalg.eigvalsh(line["covariance"]).min() > 0 for line in lines)
    # The trajectory is one that evaluate knows.
    assert main(["evaluate", str(output), str(poses)]) == 0
    assert f"{COUNT} of {COUNT} photos" in capsys.readouterr().out


def stamp(time: str) -> str:
    return time.removesuffix(".0")


def test_a_bag_with_odometry_and_a_calibration_in_a_file(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As FAST-LIVO2's data come. The photos are dark at the end, and that is said."""
    messages = Messages("bag")
    recorded: list[Any] = []
    for time in TIMES:
        nanoseconds = round(10**9 * float(time))
        image = messages.compressed(nanoseconds, read_image(folder / "walk" / f"{time}.png"))
        recorded.append(("/left_camera/image/compressed", nanoseconds, image))
    dark = messages.compressed(11 * 10**9, np.zeros((180, 240, 3), np.uint8))
    recorded.append(("/left_camera/image/compressed", 11 * 10**9, dark))
    bag = write_bag(tmp_path, "bag", recorded)
    (tmp_path / "camera_pinhole.yaml").write_text(
        f"cam_model: Pinhole\ncam_width: 240\ncam_height: 180\ncam_fx: {CAMERA.fx}\n"
        f"cam_fy: {CAMERA.fy}\ncam_cx: {CAMERA.cx - 0.5}\ncam_cy: {CAMERA.cy - 0.5}\n"
    )
    moved = se3.exp([1, 2, 3, 0.1, 0.2, 0.3])
    lines = [tum_line(time, pose @ moved) for time, pose in POSES.items()]
    (tmp_path / "odometry.tum").write_text("".join(lines))
    more = ["--camera", str(tmp_path / "camera_pinhole.yaml")]
    more += ["--odometry", str(tmp_path / "odometry.tum"), "--odometry-sigma", "0.005", "0.2"]
    assert track(folder, bag, tmp_path / "walk.tum", *more) == 0
    out, err = capsys.readouterr()
    assert counts(out) == [COUNT + 1, COUNT - 1, 1, 1, 0, 0]
    assert err == (
        "the odometry, from 10.000000 to 10.500000 s, does not cover 1 of these frames\n"
    )
    check(
        {f"{float(key):.1f}": p for key, p in read_pose_file(tmp_path / "walk.tum").poses.items()}
    )
    last = json.loads((tmp_path / "walk.details.jsonl").read_text().splitlines()[-1])
    assert (last["name"], last["status"]) == ("11.000000000", "lost")
    assert last["reason"]


def test_in_real_time(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing waits: how many frames are dropped, or come before the camera is found, is the
    machine's business. All are accounted for, and what was found is right, at half size too."""
    poses = tmp_path / "poses.txt"
    more = ["--camera", CAMERA_WORDS, "--realtime", "--fast", "--poses", str(poses)]
    status = track(folder, folder / "walk", tmp_path / "t.tum", *more)
    frames, tracked, relocalized, lost, dropped, unreadable = counts(capsys.readouterr().out)
    assert frames + dropped == COUNT
    assert tracked + relocalized + lost == frames and unreadable == 0
    found = read_pose_file(poses).poses
    assert len(found) == tracked + relocalized
    assert status == (0 if found else 1)
    check(found, 0.03)  # a pixel of 120x90 is 2 cm wide


def test_nothing_but_darkness(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_image(tmp_path / "dark" / "a.png", np.full((180, 240, 3), 3, np.uint8))
    (tmp_path / "dark" / "b.png").write_bytes(b"no photo")
    more = ["--camera", CAMERA_WORDS]
    assert track(folder, tmp_path / "dark", tmp_path / "t.tum", *more) == 1
    assert counts(capsys.readouterr().out) == [2, 0, 0, 1, 0, 1]
    assert (tmp_path / "t.tum").read_text() == ""
    statuses = [
        json.loads(line)["status"]
        for line in (tmp_path / "t.details.jsonl").read_text().splitlines()
    ]
    assert statuses == ["lost", "failed"]


class Interrupted(Tracker):
    """The real tracker, until somebody presses Ctrl-C at the third frame, or worse."""

    signal = signal.SIGINT

    def track(
        self,
        image: NDArray[np.uint8],
        camera: Camera,
        time: float | None = None,
        motion: Motion | None = None,
    ) -> TrackingResult:
        if time == 10.2:
            signal.raise_signal(self.signal)
        return super().track(image, camera, time, motion)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_run(
    number: signal.Signals,
    status: int,
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What was tracked is there; after Ctrl-C, the overlay too."""
    monkeypatch.setattr("gscpe.cli.track.Tracker", Interrupted)
    monkeypatch.setattr(Interrupted, "signal", number)
    output, overlay = tmp_path / "t.tum", tmp_path / "overlay.avi"
    overlay.write_bytes(b"of an earlier run")
    more = ["--camera", CAMERA_WORDS, "--overlay", str(overlay)]
    assert track(folder, folder / "walk", output, *more) == status
    out, err = capsys.readouterr()
    assert counts(out)[:3] == [2, 1, 1]
    assert len(read_pose_file(output).poses) == 2
    if number == signal.SIGINT:
        assert err.splitlines()[-1] == "gscpe track: interrupted"
        assert "Ctrl-C again to leave it out" in err
        assert overlay.stat().st_size > 1000
        assert (tmp_path / "overlay.avi.bak").read_bytes() == b"of an earlier run"
    else:
        assert err.splitlines()[-1] == "gscpe track: ended by SIGTERM"
        assert overlay.read_bytes() == b"of an earlier run"
    assert not list(tmp_path.glob("*.frames"))


def test_time_that_runs_backwards_in_the_middle(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What came before it counts."""
    order = [TIMES[0], TIMES[1], TIMES[3], TIMES[2]]
    (tmp_path / "list.txt").write_text("".join(f"{time}.png\n" for time in order))
    more = ["--camera", CAMERA_WORDS, "--images", str(folder / "walk")]
    assert track(folder, tmp_path / "list.txt", tmp_path / "t.tum", *more) == 2
    out, err = capsys.readouterr()
    assert counts(out)[0] == 3
    assert "that of frame 10.2.png is 0.1 s before that of 10.3.png" in err
    assert len(read_pose_file(tmp_path / "t.tum").poses) == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["WALK"], "the camera of .*walk is not known"),
        (["WALK", "--camera", "PINHOLE,240"], "is not of the form MODEL,width,height"),
        (["WALK/nothing", "--camera", CAMERA_WORDS], "there is no .*nothing; expected a video"),
        (["WALK", "--camera", CAMERA_WORDS, "--topic", "/a"], "--topic does not go with a folder"),
        (["WALK", "--camera", CAMERA_WORDS, "--rate", "-1"], "a rate must be positive"),
        (["WALK", "--camera", CAMERA_WORDS, "--odometry", "nowhere.tum"], "cannot be read"),
        (["WALK", "--camera", CAMERA_WORDS, "--poses", "OUTPUT"], "given twice"),
        (["WALK", "--camera", CAMERA_WORDS, "--overlay", "a.gif"], "does not end like a video"),
        (["device:99", "--camera", CAMERA_WORDS], "device 99 cannot be opened"),
    ],
)
def test_bad_input(
    arguments: list[str],
    words: str,
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One line, exit status 2, and no file."""
    output = tmp_path / "t.tum"
    source, *more = [
        word.replace("WALK", str(folder / "walk")).replace("OUTPUT", str(output))
        for word in arguments
    ]
    assert track(folder, source, output, *more) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.search(words, err) and err.startswith("gscpe track: ")
    assert len(err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_options_that_go_together(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit):
        track(folder, folder / "walk", tmp_path / "t.tum", "--odometry-sigma", "1", "1")
