"""``gscpe localize``: one photo, or a list of them."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Mapping, Sequence

from gscpe.batch import (
    TIMEOUT,
    Instructions,
    ListFiles,
    check_outputs,
    localize_to_files,
    result_details,
)
from gscpe.cli.common import (
    CAMERA_HELP,
    Commands,
    add_backend,
    add_matcher,
    add_timeout,
    add_workers,
    print_json,
    show_progress,
)
from gscpe.errors import CameraError, OutputError, QueryListError
from gscpe.geometry.camera import Camera
from gscpe.localization import Localizer, LocalizerSettings, PosePrior
from gscpe.scene import camera_from_exif, open_map, read_image
from gscpe.scene.pose_file import parse_pose
from gscpe.scene.query_list import Query, read_query_list


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("localize", help="find where a photo, or many, were taken")
    parser.add_argument("map", help="map folder, from gscpe build-map")
    parser.add_argument("photo", nargs="?", help="one photo")
    parser.add_argument(
        "--camera",
        help=f"of the one photo: {CAMERA_HELP}. Without: its focal length is estimated, and lens "
        "distortion taken to be small",
    )
    parser.add_argument("--json", action="store_true", help="print all about the one photo")
    parser.add_argument(
        "--prior",
        metavar="POSE",
        help='where the one photo probably was taken: "qw qx qy qz tx ty tz", world to camera',
    )
    parser.add_argument(
        "--prior-sigma",
        nargs=2,
        type=float,
        metavar=("LENGTH", "DEGREES"),
        help="standard deviations of the prior, map units and degrees "
        f"(default: {PosePrior.translation_sigma} {PosePrior.rotation_sigma_degrees})",
    )
    many = parser.add_argument_group("many photos")
    many.add_argument("--queries", metavar="FILE", help="lines of: name MODEL width height params")
    many.add_argument("--images", metavar="QUERY_DIR", help="folder of the query photos")
    many.add_argument("--output", metavar="POSES", help="poses: name qw qx qy qz tx ty tz")
    many.add_argument("--coarse-output", metavar="POSES", help="those from matches alone")
    many.add_argument(
        "--details",
        metavar="JSONL",
        help="a line a query with all that is known (default: beside the output)",
    )
    many.add_argument("--resume", action="store_true", help="keep what is in the details already")
    add_workers(many)
    add_timeout(many)
    parser.add_argument(
        "--retrieval-model",
        metavar="ONNX",
        help="the network that described the map's photos, where an exported one did",
    )
    add_matcher(parser)
    add_backend(parser)
    parser.set_defaults(run=run, parser=parser)


def run(options: argparse.Namespace) -> int:
    parser: argparse.ArgumentParser = options.parser
    if (options.photo is None) == (options.queries is None):
        parser.error("give either one photo, or --queries with --images and --output")
    one = {"camera", "json", "prior", "prior_sigma"}
    many = {"images", "output", "coarse_output", "details", "resume", "workers", "scheduler"}
    many.add("timeout")
    alien = sorted(name for name in (one if options.queries else many) if getattr(options, name))
    if alien:
        option = "--" + alien[0].replace("_", "-")
        parser.error(f"{option} does not go with {'--queries' if options.queries else 'a photo'}")
    if options.photo is not None:
        return _localize_photo(options)
    if options.images is None or options.output is None:
        parser.error("--queries needs --images and --output")
    return _localize_queries(options)


def _localize_photo(options: argparse.Namespace) -> int:
    camera = None if options.camera is None else Camera.parse(options.camera)
    prior = _prior(options)
    image = read_image(options.photo)
    if camera is not None:
        camera.check_fits(image.shape, options.photo)
    with Localizer(
        open_map(options.map),
        LocalizerSettings(retrieval_model=options.retrieval_model),
        options.matcher,
        options.backend,
        show_progress(),
    ) as localizer:
        if camera is None:
            try:
                camera = localizer.estimate_camera(image, camera_from_exif(options.photo))
            except CameraError as error:  # as if the photo were not recognized
                print(f"{options.photo}: not localized: {error}", file=sys.stderr)
                return 1
            text = camera.colmap_text().replace(" ", ",")
            print(f"camera estimated: {text}", file=sys.stderr)
        result = localizer.localize(image, camera, prior)
    if prior is not None and result.started_from == "reference":
        print("the prior did not lead to a pose; reference photos did", file=sys.stderr)
    query = Query(options.photo, camera)
    details = result_details(query, result)
    if options.json:
        print_json(details)
    elif result.localized:
        print(details["cam_from_world"])
    else:
        print(f"{query.name}: not localized: {result.reason}", file=sys.stderr)
    return 0 if result.localized else 1


def _prior(options: argparse.Namespace) -> PosePrior | None:
    if options.prior is None:
        if options.prior_sigma is not None:
            options.parser.error("--prior-sigma needs --prior")
        return None
    cam_from_world = parse_pose(options.prior)
    return PosePrior(cam_from_world, *(options.prior_sigma or ()))


def _localize_queries(options: argparse.Namespace) -> int:
    queries = read_query_list(options.queries)
    if not Path(options.images).is_dir():
        raise QueryListError(f"--images {options.images} is not a folder")
    output = Path(options.output)
    if not output.name:
        raise OutputError(f"--output {output} is a folder; give a file for the poses")
    details_path = Path(options.details or output.with_suffix(".details.jsonl"))
    check_outputs([output, details_path, options.coarse_output], inputs=[options.queries])
    instructions = Instructions.of(
        options.map,
        options.images,
        LocalizerSettings(retrieval_model=options.retrieval_model),
        options.matcher,
        options.backend,
        options.timeout or TIMEOUT,
    )
    coarse = None if options.coarse_output is None else Path(options.coarse_output)
    details, _ = localize_to_files(
        instructions,
        queries,
        ListFiles(details_path, output, coarse),
        options.workers,
        options.scheduler,
        options.resume,
        show_progress(),
    )
    return _summarize(details, output, details_path)


def _summarize(details: Sequence[Mapping[str, Any]], output: Path, details_path: Path) -> int:
    localized = sum(detail["status"] == "localized" for detail in details)
    print(f"{localized} of {len(details)} photos localized: {output}; details: {details_path}")
    failed = [detail for detail in details if detail["status"] == "failed"]
    if failed:
        print(
            f"{len(failed)} photos could not be used, the first: {failed[0]['reason']}",
            file=sys.stderr,
        )
    return 0 if localized else 1
