# SPDX-License-Identifier: Apache-2.0
"""Poses of another convention or frame are recognized; bad poses are not explained away."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray

from gscpe.cli.main import main
from gscpe.evaluation import evaluate, explain_errors
from gscpe.geometry import se3
from gscpe.geometry.similarity_transform import Similarity
from gscpe.poses import write_pose_file

Pose = NDArray[np.float64]
Poses = dict[str, Pose]

GL = np.diag([1.0, -1.0, -1.0, 1.0])


def misread(pose: Pose) -> Pose:
    """What is read where x y z w was written in place of w x y z."""
    (w, x, y, z), t = se3.to_quaternion_translation(pose)
    return se3.from_quaternion_translation([x, y, z, w], t)


MISTAKES = {
    "inverted": (("inverted",), se3.inverse),
    "quaternion": (("quaternion",), misread),
    "opengl": (("opengl",), lambda pose: GL @ pose),
    "nerfstudio": (("inverted", "opengl"), lambda pose: se3.inverse(pose) @ GL),
    "ROS": (("quaternion", "inverted"), lambda pose: misread(se3.inverse(pose))),
    "all": (
        ("quaternion", "inverted", "opengl"),
        lambda pose: misread(se3.inverse(GL @ pose)),
    ),
}


@pytest.fixture(params=[3, 12, 200])
def truth(request: pytest.FixtureRequest, rng: np.random.Generator) -> Poses:
    """A walk, cameras looking about, 1 to 100 units from the origin."""
    shift = random_pose(rng)
    shift[:3, 3] *= float(rng.choice([1.0, 30.0]))
    return {f"{i}.png": random_pose(rng) @ shift for i in range(request.param)}


def with_errors(poses: Poses, rng: np.random.Generator, wrong: float = 0.0) -> Poses:
    """Some millimetres off, and a share of the photos anywhere."""
    found = {name: se3.exp(0.003 * rng.normal(size=6)) @ pose for name, pose in poses.items()}
    for name in list(found)[: int(wrong * len(found))]:
        found[name] = random_pose(rng)
    return found


@pytest.mark.parametrize("mistake", MISTAKES)
def test_conventions_are_recognized(mistake: str, truth: Poses, rng: np.random.Generator) -> None:
    changes, make = MISTAKES[mistake]
    good = with_errors(truth, rng, 0.3)
    right = evaluate(good, truth)
    found = explain_errors({name: make(pose) for name, pose in good.items()}, truth)
    assert found is not None
    assert (found.changes, found.motion, found.of_truth) == (changes, None, False)
    # Exactly the figures of the poses as they should have been.
    assert found.median_distance == pytest.approx(right.median_distance, abs=1e-9)
    assert found.median_degrees == pytest.approx(right.median_degrees, abs=1e-6)
    # The other way round the truth is wrong, which is the same for what is its own inverse.
    found = explain_errors(good, {name: make(pose) for name, pose in truth.items()})
    assert found is not None
    assert set(found.changes) == set(changes)
    assert found.of_truth is (changes not in (("inverted",), ("opengl",)))


@pytest.mark.parametrize("scale", [1.0, 0.1, 25.0])
@pytest.mark.parametrize("mistake", [None, "inverted", "opengl", "nerfstudio"])
def test_moved_frames_are_recognized(
    scale: float, mistake: str | None, rng: np.random.Generator
) -> None:
    truth = {f"{i}.png": random_pose(rng) for i in range(40)}
    motion = Similarity(scale, random_pose(rng)[:3, :3], 10.0 * rng.normal(size=3))
    good = with_errors(truth, rng, 0.3)
    changes, make = MISTAKES[mistake] if mistake else ((), lambda pose: pose)
    found = explain_errors({n: make(motion.cam_from_b(p)) for n, p in good.items()}, truth)
    assert found is not None
    assert (found.changes, found.of_truth) == (changes, False)
    assert found.motion is not None
    if scale == 1.0:
        assert found.motion.scale == 1.0
    assert found.motion.scale == pytest.approx(1.0 / scale, rel=0.02)
    right = evaluate(good, truth)
    assert found.median_distance < 2.0 * right.median_distance
    assert found.median_degrees < 2.0 * right.median_degrees
    # What is given back really moves the poses there.
    np.testing.assert_allclose(found.motion.rotation @ motion.rotation, np.eye(3), atol=0.02)


def test_a_straight_walk_has_a_frame_too(rng: np.random.Generator) -> None:
    """Cameras on one line leave the turn about it open; their rotations do not."""
    truth = {
        f"{i}.png": se3.inverse(
            se3.from_rotation_translation(random_pose(rng)[:3, :3], [0.1 * i, 0, 0])
        )
        for i in range(20)
    }
    motion = Similarity(1.0, random_pose(rng)[:3, :3], np.array([1.0, 2.0, 3.0]))
    moved = {name: motion.cam_from_b(pose) for name, pose in with_errors(truth, rng).items()}
    found = explain_errors(moved, truth)
    assert found is not None
    assert (found.changes, found.median_distance < 0.02) == ((), True)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-3, 0.05, 0.5, 3.0])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 50])
def test_errors_are_not_explained_away(size: float, count: int, rng: np.random.Generator) -> None:
    """Whatever their size, and however few photos there are to fit a motion to."""
    for _ in range(4):
        truth = {f"{i}.png": random_pose(rng) for i in range(count)}
        found = {name: se3.exp(size * rng.normal(size=6)) @ pose for name, pose in truth.items()}
        assert explain_errors(found, truth) is None
        anywhere = {name: random_pose(rng) for name in truth}
        assert count < 3 or explain_errors(anywhere, truth) is None
    assert explain_errors({}, truth) is None
    assert explain_errors({"other.png": np.eye(4)}, truth) is None


def test_cameras_in_one_place(rng: np.random.Generator) -> None:
    """A tripod: nothing has a size, and nothing is divided by it."""
    centre = se3.exp([1, 2, 3, 0, 0, 0])
    truth = {f"{i}.png": se3.exp([0, 0, 0, *rng.normal(size=3)]) @ centre for i in range(6)}
    assert explain_errors(truth, truth) is None
    found = explain_errors({name: se3.inverse(pose) for name, pose in truth.items()}, truth)
    assert found is not None
    assert found.changes == ("inverted",)


def run_evaluate(
    folder: Path, estimates: Poses, truth: Poses, capsys: pytest.CaptureFixture[str], *more: str
) -> tuple[str, str]:
    write_pose_file(folder / "poses.txt", estimates, "hloc")
    write_pose_file(folder / "truth.txt", truth, "hloc")
    paths = str(folder / "poses.txt"), str(folder / "truth.txt")
    assert main(["evaluate", *paths, *more]) == 0
    out, err = capsys.readouterr()
    return out, err


def test_it_is_said(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With both figures, on one line; nothing where nothing is wrong."""
    truth = {f"{i}.png": random_pose(rng) for i in range(9)}
    good = with_errors(truth, rng)
    assert run_evaluate(tmp_path, good, truth, capsys)[1] == ""
    right = evaluate(good, truth)
    figures = f"{100 * right.median_distance:.3f} cm / {right.median_degrees:.3f} deg off, not "
    for mistake, words in {
        "inverted": "inverted (camera to world",
        "quaternion": "real part taken from the end",
        "opengl": "OpenGL's axes",
    }.items():
        bad = {name: MISTAKES[mistake][1](pose) for name, pose in good.items()}
        out, err = run_evaluate(tmp_path, bad, truth, capsys)
        (line,) = err.splitlines()
        assert line.startswith(f"{tmp_path / 'poses.txt'} seems to use another convention")
        assert words in line
        assert figures in line
        assert f"not {out.splitlines()[1].split()[2]} cm" in line
        data = json.loads(run_evaluate(tmp_path, bad, truth, capsys, "--json")[0])
        assert data["explanation"]["undone"] == [mistake]
        assert data["explanation"]["wrong"] == "estimates"
    moved = {name: pose @ se3.exp([5, 0, 0, 0, 1, 0]) for name, pose in good.items()}
    out, err = run_evaluate(tmp_path, moved, truth, capsys, "--metres-per-unit", "0.5")
    assert "after one rigid motion of all" in err
    data = json.loads(
        run_evaluate(tmp_path, moved, truth, capsys, "--json", "--metres-per-unit", "0.5")[0]
    )
    assert data["explanation"]["median_position_m"] < right.median_distance
    err = run_evaluate(tmp_path, good, {n: misread(p) for n, p in truth.items()}, capsys)[1]
    assert err.startswith(f"{tmp_path / 'truth.txt'} seems")


def test_units_that_are_no_metres(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = {f"{i}.png": random_pose(rng) for i in range(9)}
    good = with_errors(truth, rng)
    out, _ = run_evaluate(tmp_path, good, truth, capsys, "--unknown-scale")
    distance = evaluate(good, truth, None).median_distance
    assert f"median position  {distance:.4g} units\n" in out
    assert "cm" not in out
    data = json.loads(run_evaluate(tmp_path, good, truth, capsys, "--unknown-scale", "--json")[0])
    assert data["metres_per_unit"] is None
    assert data["median_position_units"] == pytest.approx(distance)
    assert "median_position_m" not in data
    assert {limit["share"] for limit in data["within"]} == {None}


def test_backslashes_are_slashes(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = {f"seq 1\\my {i}.png": random_pose(rng) for i in range(3)}
    found = {name.replace("\\", "/"): pose for name, pose in truth.items()}
    data = json.loads(run_evaluate(tmp_path, found, truth, capsys, "--json")[0])
    assert (data["localized"], data["not_in_truth"]) == (3, 0)
