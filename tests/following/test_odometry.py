# SPDX-License-Identifier: Apache-2.0
"""Motions between frames, from another system's trajectory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray

from gscpe.errors import PoseError, SettingsError
from gscpe.following import read_odometry
from gscpe.geometry import se3
from gscpe.poses.tum import tum_line


def test_a_steady_motion_between_its_poses(tmp_path: Path, rng: np.random.Generator) -> None:
    """A body turns about a fixed axis and moves on a line: that is what is interpolated exactly.
    The frame of the trajectory does not count, and the camera sits somewhere on the body."""
    cam_from_body, odom_from_world = random_pose(rng), random_pose(rng)

    def world_from_body(time: float) -> NDArray[np.float64]:
        pose = se3.exp([0, 0, 0, 0.3 * time, -0.2 * time, 0.1 * time])
        pose[:3, 3] = [time, 2 * time, -time]
        return np.asarray(pose)

    lines = [
        tum_line(f"{time:.1f}", se3.inverse(odom_from_world @ world_from_body(time)))
        for time in np.arange(10.0, 12.0, 0.1)
    ]
    (tmp_path / "odom.tum").write_text("# odometry\n" + "".join(lines))
    odometry = read_odometry(tmp_path / "odom.tum", cam_from_body, 0.02, 0.3)
    assert odometry.span == (10.0, 11.9)
    for before, now in ((10.0, 10.1), (10.03, 10.48), (11.9, 10.05)):
        motion = odometry.motion(before, now)
        assert motion is not None
        cam_from_world = [cam_from_body @ se3.inverse(world_from_body(t)) for t in (before, now)]
        expected = cam_from_world[1] @ se3.inverse(cam_from_world[0])
        np.testing.assert_allclose(motion.cam_from_previous_cam, expected, atol=1e-9)
        assert (motion.translation_sigma, motion.rotation_sigma) == (0.02, 0.3)
    assert odometry.motion(9.9, 10.1) is None
    assert odometry.motion(10.1, 11.95) is None


def test_a_gap(tmp_path: Path) -> None:
    lines = [tum_line(str(time), np.eye(4)) for time in (1.0, 1.4, 3.0, 3.4)]
    (tmp_path / "odom.tum").write_text("".join(lines))
    odometry = read_odometry(tmp_path / "odom.tum")
    assert odometry.motion(1.1, 1.3) is not None
    assert odometry.motion(1.3, 3.1) is not None  # both times are near poses
    assert odometry.motion(1.3, 2.2) is None


def test_what_is_no_odometry(tmp_path: Path) -> None:
    path = tmp_path / "odom.tum"
    with pytest.raises(PoseError, match="cannot be read"):
        read_odometry(path)
    path.write_text("1 2 3\n")
    with pytest.raises(PoseError, match="expected 'timestamp tx ty tz"):
        read_odometry(path)
    path.write_text(tum_line("1", np.eye(4)))
    with pytest.raises(PoseError, match="1 poses; motions need at least two"):
        read_odometry(path)
    path.write_text(tum_line("1", np.eye(4)) + tum_line("2", np.eye(4)))
    with pytest.raises(SettingsError, match="must be positive"):
        read_odometry(path, None, 0.0, 1.0)
    with pytest.raises(PoseError, match="cam_from_body"):
        read_odometry(path, 2 * np.eye(4))
