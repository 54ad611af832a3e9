# SPDX-License-Identifier: Apache-2.0
"""Whole trainings of a small room."""

from __future__ import annotations

import dataclasses
import functools
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera

from gscpe.errors import CameraError, OutputError, PoseError, TrainingError
from gscpe.geometry import se3
from gscpe.photos import Photo
from gscpe.splats import GaussianScene

pytest.importorskip("numba")

from gscpe.training import train
from gscpe.training.evaluation import likeness
from gscpe.training.points import PointCloud
from gscpe.training.progress import Progress
from gscpe.training.settings import TrainingSettings

SETTINGS = TrainingSettings(iterations=60, max_gaussians=1500, densify_rounds=4)


@functools.cache
def shots(count: int = 10, size: int = 64) -> tuple[list[Photo], NDArray[np.float64], PointCloud]:
    """Photos of the room from around its reference pose, and points on its walls."""
    rng = np.random.default_rng(3)
    camera = room_camera(size, size * 3 // 4)
    poses = np.stack(
        [se3.exp(rng.normal(0.0, (0.1,) * 3 + (0.04,) * 3)) @ ROOM_POSE for _ in range(count)]
    )
    taken = [room(smoothness=4.0).shoot(camera, pose, samples=2) for pose in poses]
    positions, colours = [], []
    for shot, pose in zip(taken[:3], poses[:3], strict=True):
        v, u = np.mgrid[2 : camera.height : 3, 2 : camera.width : 3].reshape(2, -1)
        z = shot.depth[v, u].astype(np.float64)
        in_cam = np.stack(
            [
                (u + 0.5 - camera.cx) / camera.fx * z,
                (v + 0.5 - camera.cy) / camera.fy * z,
                z,
            ],
            axis=1,
        )
        positions.append((in_cam - pose[:3, 3]) @ pose[:3, :3])
        colours.append(shot.uint8[v, u])
    photos = [Photo(shot.uint8, camera) for shot in taken]
    return photos, poses, PointCloud(np.concatenate(positions), np.concatenate(colours))


@functools.cache
def seen() -> list[NDArray[np.intp]]:
    """The points that each photo sees: those as near as what it shows in their place."""
    photos, poses, points = shots()
    found = []
    for photo, pose in zip(photos, poses, strict=True):
        camera = photo.camera
        in_cam = points.positions @ pose[:3, :3].T + pose[:3, 3]
        z = in_cam[:, 2]
        u, v = (in_cam[:, :2] / z[:, None] * (camera.fx, camera.fy) + (camera.cx, camera.cy)).T
        ahead = (z > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        depth = room(smoothness=4.0).shoot(camera, pose).depth
        indices = np.flatnonzero(ahead)
        shown = depth[v[indices].astype(int), u[indices].astype(int)]
        found.append(indices[np.abs(shown - z[indices]) < 0.02 * shown])
    return found


def same(a: GaussianScene, b: GaussianScene) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("means", "quaternions", "scales", "opacities", "sh")
    )


def test_a_room_is_recovered() -> None:
    """Photos that it has not seen too, and within the budget."""
    photos, poses, points = shots(24)
    told: list[Progress] = []
    settings = dataclasses.replace(SETTINGS, iterations=800)
    scene = train(photos[2:], poses[2:], points, settings, told.append)
    assert len(scene) <= settings.max_gaussians
    assert max(progress.gaussians for progress in told) <= settings.max_gaussians
    assert len(told) == 800 and told[-1].share == 1.0
    assert told[-1].psnr > 30.0
    assert likeness(scene, photos[:2], poses[:2]).psnr > 28.0


def test_exposures_do_not_get_into_the_colours() -> None:
    """Photos that were taken brighter and darker give a room as bright as their mean."""
    photos, poses, points = shots()
    rng = np.random.default_rng(1)
    gains = np.exp(rng.normal(0.0, 0.15, len(photos)))
    gains /= np.exp(np.mean(np.log(gains)))
    exposed = [
        Photo(np.clip(gain * photo.rgb, 0, 255).astype(np.uint8), photo.camera)
        for gain, photo in zip(gains, photos, strict=True)
    ]
    settings = dataclasses.replace(SETTINGS, iterations=300)
    scene = train(exposed, poses, points, settings)
    without = train(exposed, poses, points, dataclasses.replace(settings, exposure_rate=0.0))
    ours, theirs = (likeness(s, photos, poses) for s in (scene, without))
    assert ours.psnr > theirs.psnr + 0.5
    assert ours.fitted_psnr > theirs.fitted_psnr + 0.5


def test_twice_gives_the_same_bytes_with_any_number_of_threads() -> None:
    photos, poses, points = shots()
    once = train(photos, poses, points, SETTINGS, threads=1, seen=seen())
    assert same(once, train(photos, poses, points, SETTINGS, threads=3, seen=seen()))
    other = dataclasses.replace(SETTINGS, seed=1)
    assert not same(once, train(photos, poses, points, other, threads=1, seen=seen()))


def test_resumed_it_ends_as_if_uninterrupted(tmp_path: Path) -> None:
    """Ctrl-C at any iteration, even amid the densification."""
    photos, poses, points = shots()
    whole = train(photos, poses, points, SETTINGS, seen=seen())
    file = tmp_path / "room.checkpoint"
    stops = (1, 13, 30, 47)

    def interrupt(progress: Progress) -> None:
        if progress.iteration in stops:
            signal.raise_signal(signal.SIGINT)

    for stop in stops:
        with pytest.raises(KeyboardInterrupt):
            train(photos, poses, points, SETTINGS, interrupt, file, resume=stop > 1, seen=seen())
    with pytest.raises(TrainingError, match="other photos, points or settings"):
        train(photos, poses, points, SETTINGS, None, file, resume=True)
    assert same(whole, train(photos, poses, points, SETTINGS, None, file, resume=True, seen=seen()))


def test_interrupted_it_never_passes_for_finished(tmp_path: Path) -> None:
    """Ignored, as in the background of a shell, Ctrl-C stops nothing; and a handler that does not
    raise does not turn half a training into a result."""
    photos, poses, points = shots()
    short = dataclasses.replace(SETTINGS, iterations=6)

    def interrupt(progress: Progress) -> None:
        if progress.iteration == 3:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        ignored = train(photos, poses, points, short, interrupt)
        signal.signal(signal.SIGINT, lambda *_: None)
        with pytest.raises(KeyboardInterrupt):
            train(photos, poses, points, short, interrupt)
    finally:
        signal.signal(signal.SIGINT, before)
    assert same(ignored, train(photos, poses, points, short))


def test_killed_it_goes_on(tmp_path: Path) -> None:
    """kill -9 leaves the checkpoint before it, whole."""
    file = tmp_path / "room.checkpoint"
    program = f"""
import os, signal, sys
from pathlib import Path
sys.path[:0] = {sys.path!r}
import gscpe.training.loop as t
from test_train import SETTINGS, shots
t._CHECKPOINT_SECONDS = 0.0
def stop(progress):
    if progress.iteration == 40:
        os.kill(os.getpid(), signal.SIGKILL)
photos, poses, points = shots()
t.train(photos, poses, points, SETTINGS, stop, Path({str(file)!r}))
"""
    done = subprocess.run([sys.executable, "-c", program], check=False, env=dict(os.environ))
    assert done.returncode == -signal.SIGKILL
    photos, poses, points = shots()
    told: list[Progress] = []
    resumed = train(photos, poses, points, SETTINGS, told.append, file, resume=True)
    assert told[0].iteration == 40  # 39 were in the checkpoint
    assert same(resumed, train(photos, poses, points, SETTINGS))


def test_a_checkpoint_that_does_not_fit(tmp_path: Path) -> None:
    photos, poses, points = shots()
    file = tmp_path / "room.checkpoint"
    with pytest.raises(TrainingError, match="no checkpoint"):
        train(photos, poses, points, SETTINGS, checkpoint=file, resume=True)
    short = dataclasses.replace(SETTINGS, iterations=2)
    train(photos, poses, points, short, checkpoint=file)
    with pytest.raises(TrainingError, match="other photos, points or settings"):
        train(photos, poses, points, SETTINGS, checkpoint=file, resume=True)
    with pytest.raises(TrainingError, match="other photos, points or settings"):
        train(photos[1:], poses[1:], points, short, checkpoint=file, resume=True)
    whole = file.read_bytes()
    for damaged in (b"", b"nonsense", whole[: len(whole) // 2]):
        file.write_bytes(damaged)
        with pytest.raises(TrainingError, match="damaged"):
            train(photos, poses, points, short, checkpoint=file, resume=True)


def test_a_full_disk_is_told_before_anything_is_trained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos, poses, points = shots()
    told: list[Progress] = []

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OutputError, match=r"No space left.*free some space"):
        train(photos, poses, points, SETTINGS, told.append, tmp_path / "room.checkpoint")
    assert not told
    assert not list(tmp_path.iterdir())


def test_minutes_are_kept_and_the_schedule_passed_through() -> None:
    photos, poses, points = shots()
    told: list[Progress] = []
    settings = dataclasses.replace(SETTINGS, iterations=30_000, minutes=0.05)
    scene = train(photos, poses, points, settings, told.append)
    assert told[-1].share == 1.0
    assert scene.sh_degree == 3
    assert 0 < len(told) < 30_000
    shares = [progress.share for progress in told]
    assert shares == sorted(shares)


def test_bad_input() -> None:
    photos, poses, points = shots()
    with pytest.raises(TrainingError, match="2 photos are too few"):
        train(photos[:2], poses[:2], points, SETTINGS)
    with pytest.raises(TrainingError, match="10 photos, but 4 poses"):
        train(photos, poses[:4], points, SETTINGS)
    with pytest.raises(PoseError, match="photo 9 is not a rigid transform"):
        train(photos, np.concatenate([poses[:9], 2 * poses[9:]]), points, SETTINGS)
    bent = dataclasses.replace(photos[3].camera, distortion=(0.1, *(0.0,) * 7))
    with pytest.raises(CameraError, match="photo 3 has lens distortion"):
        train([*photos[:3], Photo(photos[3].rgb, bent), *photos[4:]], poses, points, SETTINGS)
    with pytest.raises(CameraError, match="photo 1 is 64x47"):
        small = Photo(photos[1].rgb[1:], photos[1].camera)
        train([photos[0], small, *photos[2:]], poses, points, SETTINGS)
