"""``gscpe build-map``."""

from __future__ import annotations

import argparse
import sys

from gscpe.cli.common import Commands, add_backend, show_progress
from gscpe.mapping import MapSettings, build_map, map_without_references, with_fitting_axes
from gscpe.retrieval import METHODS, check_method
from gscpe.scene import read_splat, save_map
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.map_folder import check_map_output
from gscpe.scene.splat_kind import may_have_other_axes


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("build-map", help="make a map from a splat and its photos")
    parser.add_argument(
        "splat", help="trained 3D Gaussian splat (.ply; also .spz, .splat, .ksplat, .sog)"
    )
    parser.add_argument(
        "--colmap", metavar="MODEL_DIR", help="COLMAP model of the photos, in the splat's frame"
    )
    parser.add_argument("--images", metavar="IMAGE_DIR", help="the model's photos")
    parser.add_argument(
        "--no-references",
        action="store_true",
        help="a splat alone, without photos: every query then needs a prior pose",
    )
    parser.add_argument("--output", required=True, metavar="MAP", help="map folder to write")
    scale = parser.add_mutually_exclusive_group()
    scale.add_argument(
        "--metres-per-unit",
        type=float,
        default=1.0,
        help="length of a unit of the splat in metres (default: %(default)s)",
    )
    scale.add_argument(
        "--unknown-scale",
        action="store_true",
        help="the splat is not metric: tolerances in metres are scaled to the scene's depth",
    )
    parser.add_argument(
        "--no-check",
        action="store_true",
        help="do not compare renders with photos to see that splat and model fit together",
    )
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


def run(options: argparse.Namespace) -> int:
    given = options.colmap is not None, options.images is not None
    if given != ((False, False) if options.no_references else (True, True)):
        options.parser.error("give --colmap and --images, or --no-references")
    settings = MapSettings(
        retrieval=options.retrieval,
        metres_per_unit=None if options.unknown_scale else options.metres_per_unit,
    )
    check_map_output(options.output, compress=options.compress)
    if (options.no_references or options.no_check) and may_have_other_axes(options.splat):
        print(
            f"{options.splat} does not say its axes, and nothing is compared: they are taken as "
            "they are stored (y and z may be negated against the .ply)",
            file=sys.stderr,
        )
    if options.no_references:
        scene = read_splat(options.splat)
        map_ = map_without_references(scene, settings.metres_per_unit)
        save_map(map_, options.output, compress=options.compress)
        print(f"{options.output}: {len(scene)} Gaussians, no reference photos")
        return 0
    check_method(settings.retrieval)
    references = read_colmap_references(options.colmap, options.images)
    scene = read_splat(options.splat)
    if not options.no_check:
        scene = with_fitting_axes(
            scene,
            references,
            options.images,
            options.backend,
            show_progress(),
            may_have_other_axes(options.splat),
        )
    map_ = build_map(scene, references, options.images, settings, progress=show_progress())
    save_map(map_, options.output, compress=options.compress)
    print(f"{options.output}: {len(scene)} Gaussians, {len(references)} reference photos")
    return 0
