# SPDX-License-Identifier: Apache-2.0
"""``gscpe build-map``."""

from __future__ import annotations

import argparse
import logging
import sys

from gscpe.cli.build_map_alone import NOT_GOOD, from_splat_alone
from gscpe.cli.common import Commands, add_backend, show_progress
from gscpe.geometry.similarity_transform import Similarity
from gscpe.mapping import (
    FrameCheckSettings,
    MapSettings,
    build_map,
    check_frames,
    check_map,
    map_without_references,
    measure_misfit,
    read_transform,
    with_fitting_axes,
)
from gscpe.retrieval import METHODS, check_method
from gscpe.scene import References, open_map, save_map
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.map_folder import check_map_output
from gscpe.scene.moved import move_references, move_scene
from gscpe.splats import GaussianScene, read_splat
from gscpe.splats.splat_kind import may_have_other_axes
from gscpe.viewpoints import ViewpointSettings

_log = logging.getLogger(__name__)


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser(
        "build-map", help="make a map from a splat, with its photos or without"
    )
    parser.add_argument(
        "splat", help="trained 3D Gaussian splat (.ply; also .spz, .splat, .ksplat, .sog)"
    )
    parser.add_argument(
        "--colmap", metavar="MODEL_DIR", help="COLMAP model of the photos, in the splat's frame"
    )
    parser.add_argument("--images", metavar="IMAGE_DIR", help="the model's photos")
    _add_alone(parser)
    parser.add_argument("--output", required=True, metavar="MAP", help="map folder to write")
    scale = parser.add_mutually_exclusive_group()
    scale.add_argument(
        "--metres-per-unit",
        type=float,
        default=1.0,
        help="length of a unit of the poses in metres (default: %(default)s)",
    )
    scale.add_argument(
        "--unknown-scale",
        action="store_true",
        help="the splat is not metric: tolerances in metres are scaled to the scene's depth",
    )
    _add_fit(parser)
    parser.add_argument(
        "--retrieval",
        metavar="METHOD",
        default=MapSettings.retrieval,
        help=f"how photos are described to find similar ones: {', '.join(METHODS)} "
        "(default: %(default)s); vlad-xfeat needs gscpe models install xfeat, PATH is that of an "
        "exported network (docs/formats.md)",
    )
    parser.add_argument(
        "--compress",
        action="store_true",
        help="store the splat as .spz: less than a fifth of the size, with rounded values "
        "(needs gaussforge: pip install 'gscpe[formats]')",
    )
    add_backend(parser)
    parser.set_defaults(run=run, parser=parser)


def _add_alone(parser: argparse.ArgumentParser) -> None:
    """What is done with a splat that has no photos."""
    alone = parser.add_mutually_exclusive_group()
    alone.add_argument(
        "--virtual-references",
        action="store_true",
        help="a splat alone, without photos: places are recognized by renders from viewpoints that "
        "are found in its free space",
    )
    parser.add_argument(
        "--up",
        type=_direction,
        metavar="X,Y,Z",
        help="with --virtual-references: the direction that is up in the splat (default: found); "
        "write --up=-1,0,0 where it begins with a minus",
    )
    parser.add_argument(
        "--camera",
        metavar="CAMERA",
        help="with --virtual-references: pinhole camera of the renders, best that of the photos "
        "that the splat was trained on (default: "
        f"{ViewpointSettings().camera.colmap_text().replace(' ', ',')})",
    )
    alone.add_argument(
        "--no-references",
        action="store_true",
        help="a splat alone, without photos: every query then needs a prior pose",
    )


def _add_fit(parser: argparse.ArgumentParser) -> None:
    """Whether splat and model fit together, and what is done where they do not."""
    parser.add_argument(
        "--no-check",
        action="store_true",
        help="neither measure how splat and model fit together, nor localize a few of the photos "
        "(with --virtual-references: of renders) in the finished map to see that they come back to "
        "their poses",
    )
    parser.add_argument(
        "--fit",
        action="store_true",
        help="where splat and model do not fit, make them: measure the similarity between them by "
        "a few photos, and apply it",
    )
    parser.add_argument(
        "--transform",
        metavar="FILE",
        help="what was done to the splat: nerfstudio's dataparser_transforms.json, or a 3x4 or "
        "4x4 matrix that takes the model's points to the splat's",
    )
    parser.add_argument(
        "--poses-in",
        choices=("splat", "model"),
        default="splat",
        help="with --fit or --transform: whose frame poses are given in; the other is moved into "
        "it (default: %(default)s)",
    )


def run(options: argparse.Namespace) -> int:
    _check_options(options)
    settings = MapSettings(
        retrieval=options.retrieval,
        metres_per_unit=None if options.unknown_scale else options.metres_per_unit,
    )
    moved_by = None if options.transform is None else read_transform(options.transform)
    check_map_output(options.output, compress=options.compress)
    if options.no_references:
        return _without_references(settings, options)
    check_method(settings.retrieval)
    if options.virtual_references:
        return from_splat_alone(_read_splat(options), settings, options)
    return _from_splat_and_photos(settings, moved_by, options)


def _check_options(options: argparse.Namespace) -> None:
    """Ends the program where options do not go together."""
    given = options.colmap is not None, options.images is not None
    alone = _is_alone(options)
    if given != ((False, False) if alone else (True, True)):
        options.parser.error(
            "give --colmap and --images, or --no-references, or --virtual-references"
        )
    if alone and (options.fit or options.transform):
        options.parser.error("--fit and --transform move reference poses; there are none")
    if options.poses_in != "splat" and not (options.fit or options.transform):
        options.parser.error("--poses-in goes with --fit or --transform")
    if (options.up or options.camera) and not options.virtual_references:
        options.parser.error("--up and --camera go with --virtual-references")


def _is_alone(options: argparse.Namespace) -> bool:
    """Whether there is a splat without photos."""
    return bool(options.no_references or options.virtual_references)


def _read_splat(options: argparse.Namespace) -> GaussianScene:
    scene = read_splat(options.splat)
    if (_is_alone(options) or options.no_check) and may_have_other_axes(options.splat):
        print(
            f"{options.splat} does not say its axes, and nothing is compared: they are taken as "
            "they are stored (y and z may be negated against the .ply)",
            file=sys.stderr,
        )
    return scene


def _without_references(settings: MapSettings, options: argparse.Namespace) -> int:
    scene = _read_splat(options)
    map_ = map_without_references(scene, settings.metres_per_unit)
    save_map(map_, options.output, compress=options.compress)
    print(f"{options.output}: {len(scene)} Gaussians, no reference photos")
    return 0


def _from_splat_and_photos(
    settings: MapSettings, moved_by: Similarity | None, options: argparse.Namespace
) -> int:
    references = read_colmap_references(options.colmap, options.images)
    scene = _read_splat(options)
    if not options.no_check:
        scene = with_fitting_axes(
            scene,
            references if moved_by is None else move_references(references, moved_by),
            options.images,
            metres_per_unit=settings.metres_per_unit,
            backend=options.backend,
            progress=show_progress(),
            axes_are_open=may_have_other_axes(options.splat),
        )
    if moved_by is not None:
        scene, references = _moved(scene, references, moved_by, options.poses_in)
    if options.fit:
        scene, references = _fitted(scene, references, settings, options)
    if not options.no_check:
        check_frames(
            scene,
            references,
            options.images,
            metres_per_unit=settings.metres_per_unit,
            backend=options.backend,
            progress=show_progress(),
        )
    map_ = build_map(scene, references, options.images, settings, progress=show_progress())
    save_map(map_, options.output, compress=options.compress)
    written = f"{options.output}: {len(scene)} Gaussians, {references.count_text()}"
    try:
        status = 0 if options.no_check else _check_what_was_written(options)
    except KeyboardInterrupt:
        print(f"{written}; written, but not checked", file=sys.stderr)
        raise
    print(written)
    return status


def _direction(text: str) -> tuple[float, float, float]:
    parts = text.split(",")
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"give three numbers, as 0,-1,0; not {text!r}")
    try:
        x, y, z = (float(part) for part in parts)
    except ValueError:
        raise argparse.ArgumentTypeError(f"give three numbers, as 0,-1,0; not {text!r}") from None
    return x, y, z


def _fitted(
    scene: GaussianScene,
    references: References,
    settings: MapSettings,
    options: argparse.Namespace,
) -> tuple[GaussianScene, References]:
    misfit = measure_misfit(
        scene,
        references,
        options.images,
        metres_per_unit=settings.metres_per_unit,
        backend=options.backend,
        progress=show_progress(),
    )
    if misfit.verdict(FrameCheckSettings()) == "fits":
        print(f"splat and model fit as they are: {misfit}")
        return scene, references
    print(f"{'splat' if options.poses_in == 'model' else 'poses'} moved, for {misfit}")
    return _moved(scene, references, misfit.splat_from_model, options.poses_in)


def _moved(
    scene: GaussianScene, references: References, splat_from_model: Similarity, poses_in: str
) -> tuple[GaussianScene, References]:
    if poses_in == "model":
        return move_scene(scene, splat_from_model.inverse()), references
    return scene, move_references(references, splat_from_model)


def _check_what_was_written(options: argparse.Namespace) -> int:
    """Opens the map again, so that what is checked is what others will use."""
    check = check_map(
        open_map(options.output), options.images, backend=options.backend, progress=show_progress()
    )
    if check.good:
        _log.info("%s", check)
        return 0
    print(
        f"gscpe build-map: {options.output} is written, but it is not good: {check}",
        file=sys.stderr,
    )
    return NOT_GOOD
