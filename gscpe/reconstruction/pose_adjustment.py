# SPDX-License-Identifier: Apache-2.0
"""Known poses refined by what the photos show: triangulation at the poses as they are, bundle
adjustment, again with tighter bounds, until nothing moves.

COLMAP's recipe for known poses (https://colmap.github.io/faq.html), repeated; pycolmap's
triangulation and bundle adjustment.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array
from gscpe.cores import available_cores
from gscpe.geometry.pose_error import camera_centre
from gscpe.geometry.similarity_transform import fit_similarity_of_poses
from gscpe.reconstruction.frame import move_model, poses_of
from gscpe.scene.colmap_database import pose_model

_LEAST_MATCHES = 15  # of a pair of photos, as in COLMAP
_MIN_ANGLE = 1.5  # degrees between the rays of a point, as in COLMAP
_SETTLED = 0.1  # pixels that a round still moves what a photo shows, in the median
_SOLVES = 2  # bundle adjustments a round, with what does not fit left out between them
_ITERATIONS = 30
_PRIOR_SIGMAS = 3.0


@dataclass(frozen=True)
class Bounds:
    """What points must agree with.

    Attributes:
        first, last: pixels between a point and its feature, in the first and the last rounds; it is
            halved from round to round.
        rounds: at most.
        least_points: that a photo must see at the end.
        refine_focal_length: of the cameras, too.
        seed: of what is sampled.
    """

    first: float
    last: float
    rounds: int
    least_points: int
    refine_focal_length: bool
    seed: int


def adjust_poses(
    database: Path,
    given: Mapping[str, Float64Array],
    misfit: float,
    bounds: Bounds,
    progress: bool = False,
) -> Any:
    """A pycolmap.Reconstruction of the photos that see enough points, in the frame of the poses
    that were given: position, orientation and scale are those that agree best with them.

    The positions that were given hold what the photos leave open, weakly: by their own errors, as
    the matches tell of them.

    Args:
        database: with the cameras and verified matches.
        given: ``cam_from_world``, (4, 4), by name.
        misfit: typical distance of matches from where these poses want them, pixels.
        bounds: how far points may be off.
        progress: show a bar.
    """
    import pycolmap

    options = pycolmap.DatabaseCacheOptions()
    options.min_num_matches = _LEAST_MATCHES
    with pycolmap.Database.open(database) as stored:
        cache = pycolmap.DatabaseCache.create(stored, options)
    cameras: dict[int, Any] = {}
    poses, error = dict(given), bounds.first
    model = None
    bar = tqdm(total=bounds.rounds, desc="refining poses", unit="round", disable=not progress)
    with bar:
        for _ in range(bounds.rounds):
            model, observed = _triangulated(cache, poses, cameras, error, bounds.seed)
            lever, focal = _lever(model), _focal(model)
            sigma = _PRIOR_SIGMAS * max(misfit, 0.1) / focal * lever
            for _ in range(_SOLVES):
                if not _solve(model, given, sigma, error, bounds):
                    break
                observed.filter_all_points3D(error, _MIN_ANGLE)
            _put_back(model, given, lever)
            before, poses = poses, {**poses, **_sure_poses(model)}
            cameras = {number: camera.todict() for number, camera in model.cameras.items()}
            moved = _moved(before, poses, lever, focal)
            bar.set_postfix_str(f"{moved:.2f} px", refresh=False)
            bar.update(1)
            if error <= bounds.last and moved < _SETTLED:
                break
            error = max(error / 2.0, bounds.last)
    assert model is not None
    _drop(model, observed, bounds.least_points)
    if model.num_reg_images() >= 2 and _solve(model, given, sigma, bounds.last, bounds):
        observed.filter_all_points3D(bounds.last, _MIN_ANGLE)
        _drop(model, observed, bounds.least_points)
    if model.num_reg_images():
        _put_back(model, given, lever)
    return model


def _triangulated(
    cache: Any,
    poses: Mapping[str, Float64Array],
    cameras: Mapping[int, Any],
    error: float,
    seed: int,
) -> tuple[Any, Any]:
    """The model with points at these poses, and its pycolmap.ObservationManager."""
    import pycolmap

    model = pose_model(
        cache.cameras.values(),
        cache.rigs.values(),
        cache.frames.values(),
        cache.images.values(),
        poses,
    )
    for number, values in cameras.items():
        model.cameras[number].mergedict(values)
    graph = cache.correspondence_graph
    observed = pycolmap.ObservationManager(model, graph)
    triangulator = pycolmap.IncrementalTriangulator(graph, model, observed)
    options = pycolmap.IncrementalTriangulatorOptions()
    degrees = float(np.degrees(np.arctan(error / _focal(model))))
    options.create_max_angle_error = options.continue_max_angle_error = degrees
    options.merge_max_reproj_error = options.complete_max_reproj_error = error
    options.min_angle = _MIN_ANGLE
    options.random_seed = seed
    for number in sorted(model.reg_image_ids()):
        triangulator.triangulate_image(options, number)
    triangulator.complete_all_tracks(options)
    triangulator.merge_all_tracks(options)
    observed.filter_all_points3D(error, _MIN_ANGLE)
    return model, observed


def _solve(
    model: Any, given: Mapping[str, Float64Array], sigma: float, error: float, bounds: Bounds
) -> bool:
    """Adjusts poses and points; whether there was anything to adjust."""
    import pycolmap

    config = pycolmap.BundleAdjustmentConfig()
    priors = []
    for number in model.reg_image_ids():
        image = model.images[number]
        if image.num_points3D < _LEAST_MATCHES:
            continue  # too few to tell anything; it stays where it is
        config.add_image(number)
        pose = given[str(image.name)]
        prior = pycolmap.PosePrior()
        prior.corr_data_id = image.data_id
        prior.position = camera_centre(pose)
        prior.position_covariance = sigma**2 * np.eye(3)
        prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
        priors.append(prior)
    if len(priors) < 2:
        return False
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_focal_length = bounds.refine_focal_length
    options.refine_extra_params = options.refine_principal_point = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = max(error / 4.0, 0.5)
    options.ceres.solver_options.max_num_iterations = _ITERATIONS
    options.ceres.solver_options.function_tolerance = 1e-6
    options.ceres.solver_options.num_threads = available_cores()
    held = pycolmap.PosePriorBundleAdjustmentOptions()
    held.ceres.prior_position_loss_function_type = pycolmap.LossFunctionType.CAUCHY
    held.alignment_ransac.random_seed = bounds.seed
    adjuster = pycolmap.create_pose_prior_bundle_adjuster(options, held, config, priors, model)
    return bool(adjuster.solve().is_solution_usable())


def _put_back(model: Any, given: Mapping[str, Float64Array], lever: float) -> None:
    """Moves a model to where its poses agree best with those that were given."""
    ours = _sure_poses(model)
    if len(ours) < 2:
        return
    names = list(ours)
    fit = fit_similarity_of_poses(
        np.stack([given[name] for name in names]), np.stack([ours[name] for name in names]), lever
    )
    move_model(model, fit.b_from_a)


def _drop(model: Any, observed: Any, least: int) -> None:
    """Takes out photos that see too few points, and then those that see too few without them."""
    while True:
        few = [
            image.frame_id
            for image in model.images.values()
            if image.has_pose and image.num_points3D < least
        ]
        if not few:
            return
        for number in few:
            observed.deregister_frame(number)


def _sure_poses(model: Any) -> dict[str, Float64Array]:
    """Of the photos that see enough for a pose."""
    points = {str(image.name): image.num_points3D for image in model.images.values()}
    return {name: pose for name, pose in poses_of(model).items() if points[name] >= _LEAST_MATCHES}


def _moved(
    before: Mapping[str, Float64Array],
    after: Mapping[str, Float64Array],
    lever: float,
    focal: float,
) -> float:
    """How far what is seen moved in the photos, pixels, in the median."""
    if not after:
        return 0.0
    moves = []
    for name, pose in after.items():
        step = pose @ np.linalg.inv(before[name])
        moves.append(np.linalg.norm(step[:3, :3] - np.eye(3)) / np.sqrt(2.0))
        moved = np.linalg.norm(camera_centre(pose) - camera_centre(before[name]))
        moves[-1] += moved / lever
    return focal * float(np.median(moves))


def _lever(model: Any) -> float:
    """How far away from the cameras the points are, in the median; scene units."""
    depths = []
    for image in model.images.values():
        if image.has_pose and image.num_points3D:
            seen = [model.points3D[i].xyz for i in image_points(image)]
            pose = image.cam_from_world().matrix()
            depths.append(np.median(np.array(seen) @ pose[2, :3] + pose[2, 3]))
    return float(np.median(depths)) if depths else 1.0


def image_points(image: Any) -> list[int]:
    """Numbers of the points that a pycolmap.Image sees."""
    return [point.point3D_id for point in image.points2D if point.has_point3D()]


def _focal(model: Any) -> float:
    return float(np.median([camera.mean_focal_length() for camera in model.cameras.values()]))
