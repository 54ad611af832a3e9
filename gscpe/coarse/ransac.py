# SPDX-License-Identifier: Apache-2.0
"""Absolute poses sampled by LO-RANSAC, with pycolmap or OpenCV: one interface."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import MissingDependencyError, SettingsError
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.interrupts import handlers_kept
from gscpe.ranges import check_numbers, check_whole

Solver = Literal["auto", "pycolmap", "opencv"]


@dataclass(frozen=True)
class RansacSettings:
    """Settings of the sampling.

    Attributes:
        solver: ``"opencv"``, ``"pycolmap"``, or ``"auto"``; see :func:`choose_solver`.
        max_iterations: samples at most (paper: 2000).
        inlier_pixels: largest reprojection error of an inlier.
        confidence: it stops when it has missed no better pose with this probability.
        seed: of the sampling; the same seed gives the same pose.
    """

    solver: Solver = "auto"
    max_iterations: int = 2000
    inlier_pixels: float = 4.0
    confidence: float = 0.9999
    seed: int = 0

    def __post_init__(self) -> None:
        _check_solver(self.solver)
        check_whole(self, "max_iterations", least=1)
        check_numbers(self, "inlier_pixels", above=0)
        check_numbers(self, "confidence", above=0, below=1)
        check_whole(self, "seed", least=0)


def _check_solver(solver: Solver) -> None:
    if solver not in ("auto", "pycolmap", "opencv"):
        raise SettingsError(f"solver must be auto, pycolmap or opencv, not {solver!r}")


def choose_solver(solver: Solver) -> Literal["pycolmap", "opencv"]:
    """The solver to use; ``"auto"`` takes pycolmap where it is installed (there is no wheel
    for Arm Linux), else OpenCV.

    Raises:
        MissingDependencyError: pycolmap was asked for and is not installed.
        SettingsError: there is no such solver.
    """
    _check_solver(solver)
    if solver == "opencv":
        return "opencv"
    if importlib.util.find_spec("pycolmap") is not None:
        return "pycolmap"
    if solver == "pycolmap":
        raise MissingDependencyError(
            "solver='pycolmap' needs pycolmap: pip install pycolmap, or take solver='opencv'"
        )
    return "opencv"


def sample_absolute_pose(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    settings: RansacSettings | None = None,
) -> Float64Array | None:
    """cam_from_world, (4, 4), by LO-RANSAC; None when no sample gave one. Repeatable.

    Args:
        points_world: (N, 3).
        pixels: (N, 2), the centre of the top-left pixel at (0.5, 0.5).
        camera: pinhole camera of the pixels.
        settings: see :class:`RansacSettings`.
    """
    settings = settings or RansacSettings()
    sample = _pycolmap if choose_solver(settings.solver) == "pycolmap" else _opencv
    return sample(points_world, pixels, camera, settings)


def _pycolmap(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    settings: RansacSettings,
) -> Float64Array | None:
    with handlers_kept():
        import pycolmap

    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = settings.inlier_pixels
    options.ransac.confidence = settings.confidence
    options.ransac.max_num_trials = settings.max_iterations
    options.ransac.min_num_trials = min(100, settings.max_iterations)
    options.ransac.random_seed = settings.seed
    colmap_camera = pycolmap.Camera(
        model="PINHOLE",
        width=camera.width,
        height=camera.height,
        params=[camera.fx, camera.fy, camera.cx, camera.cy],
    )
    found = pycolmap.estimate_absolute_pose(pixels, points_world, colmap_camera, options)
    if found is None:
        return None
    cam_from_world = np.eye(4)
    cam_from_world[:3] = found["cam_from_world"].matrix()
    return cam_from_world if np.all(np.isfinite(cam_from_world)) else None


def _opencv(
    points_world: Float64Array,
    pixels: Float64Array,
    camera: Camera,
    settings: RansacSettings,
) -> Float64Array | None:
    params = cv2.UsacParams()
    params.randomGeneratorState = settings.seed
    params.confidence = settings.confidence
    params.maxIterations = settings.max_iterations
    params.threshold = settings.inlier_pixels
    params.score = cv2.SCORE_METHOD_MSAC
    params.sampler = cv2.SAMPLING_UNIFORM
    params.loMethod = cv2.LOCAL_OPTIM_INNER_LO
    params.loIterations = 10
    try:
        found, _, rotation_vector, translation, _ = cv2.solvePnPRansac(
            points_world, pixels - 0.5, camera.opencv_matrix(), None, params=params
        )
    except cv2.error:  # a degenerate configuration, for example all points on one line
        return None
    if not found or not np.all(np.isfinite(np.concatenate([rotation_vector, translation]))):
        return None
    rotation, _ = cv2.Rodrigues(rotation_vector)
    return se3.from_rotation_translation(rotation, translation[:, 0])
