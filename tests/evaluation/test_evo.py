# SPDX-License-Identifier: Apache-2.0
"""Our trajectories and errors against evo's (an independent program, GPL: in tests only)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray

from gscpe.cli.main import main
from gscpe.evaluation import evaluate
from gscpe.geometry import se3
from gscpe.poses import read_pose_file, write_pose_file

metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed")
file_interface = pytest.importorskip("evo.tools.file_interface", reason="evo is not installed")

Poses = dict[str, NDArray[np.float64]]


@pytest.fixture
def truth(rng: np.random.Generator) -> Poses:
    return {f"rgb/{1305031102.25 + i / 16}.png": random_pose(rng) for i in range(41)}


@pytest.fixture
def estimates(truth: Poses, rng: np.random.Generator) -> Poses:
    """Centimetres and degrees off."""
    return {name: se3.exp(rng.normal(scale=0.02, size=6)) @ pose for name, pose in truth.items()}


def test_evo_reads_our_trajectories(truth: Poses, tmp_path: Path) -> None:
    write_pose_file(tmp_path / "truth.tum", truth, "tum")
    trajectory = file_interface.read_tum_trajectory_file(tmp_path / "truth.tum")
    valid, details = trajectory.check()
    assert valid, details
    np.testing.assert_array_equal(trajectory.timestamps, 1305031102.25 + np.arange(41) / 16)
    for world_from_cam, cam_from_world in zip(trajectory.poses_se3, truth.values(), strict=True):
        np.testing.assert_allclose(world_from_cam, se3.inverse(cam_from_world), atol=1e-9)


def test_we_read_evos_trajectories(truth: Poses, tmp_path: Path) -> None:
    write_pose_file(tmp_path / "ours.tum", truth, "tum")
    trajectory = file_interface.read_tum_trajectory_file(tmp_path / "ours.tum")
    file_interface.write_tum_trajectory_file(tmp_path / "evos.tum", trajectory)
    again = read_pose_file(tmp_path / "evos.tum")
    assert again.format == "tum"
    for ours, theirs in zip(truth.values(), again.poses.values(), strict=True):
        np.testing.assert_allclose(theirs, ours, atol=1e-9)


def test_errors_are_evos(
    truth: Poses, estimates: Poses, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Absolute errors without alignment, from the same files."""
    write_pose_file(tmp_path / "truth.tum", truth, "tum")
    write_pose_file(tmp_path / "estimates.tum", estimates, "tum")
    pair = tuple(
        file_interface.read_tum_trajectory_file(tmp_path / f"{name}.tum")
        for name in ("truth", "estimates")
    )
    medians = {}
    for relation in (
        metrics.PoseRelation.translation_part,
        metrics.PoseRelation.rotation_angle_deg,
    ):
        ape = metrics.APE(relation)
        ape.process_data(pair)
        medians[relation] = ape.get_statistic(metrics.StatisticsType.median)
    distance, degrees = medians.values()
    assert distance > 0.01
    assert degrees > 0.5

    result = evaluate(estimates, truth)
    assert result.median_distance == pytest.approx(distance, abs=1e-6)
    assert result.median_degrees == pytest.approx(degrees, abs=1e-6)

    assert main(["evaluate", *(str(tmp_path / f"{n}.tum") for n in ("estimates", "truth")),
                 "--json"]) == 0  # fmt: skip
    data = json.loads(capsys.readouterr().out)
    assert data["localized"] == 41
    assert data["median_position_m"] == pytest.approx(distance, abs=1e-6)
    assert data["median_rotation_degrees"] == pytest.approx(degrees, abs=1e-6)
