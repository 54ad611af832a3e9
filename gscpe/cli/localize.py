# SPDX-License-Identifier: Apache-2.0
"""``gscpe localize``: one photo, or a list of them."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Mapping, Sequence

from tqdm import tqdm

from gscpe.batch import (
    MAPS_TRIED,
    TIMEOUT,
    Building,
    Instructions,
    ListFiles,
    OnePhoto,
    OneResult,
    Shelf,
    check_outputs,
    localize_one,
    localize_to_files,
    read_priors,
    shelf_order,
)
from gscpe.cli.common import (
    CAMERA_HELP,
    Commands,
    add_backend,
    add_matcher,
    add_retrieval_model,
    add_timeout,
    add_workers,
    print_json,
    show_progress,
)
from gscpe.errors import OutputError, QueryListError
from gscpe.geometry.camera import Camera
from gscpe.localization import Localizer, LocalizerSettings, PosePrior
from gscpe.localization.result import deviations_text
from gscpe.report.comparison import compare, strip_path
from gscpe.scene import open_map, read_image_of, write_image
from gscpe.scene.image_file import photo_bytes
from gscpe.scene.poses.hloc import parse_pose
from gscpe.scene.query_list import Query, fit_queries, folder_queries, read_query_list


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("localize", help="find where one photo, or many, were taken")
    parser.add_argument("map", help="map folder, from gscpe build-map")
    parser.add_argument("photo", nargs="?", help="one photo")
    parser.add_argument(
        "--camera",
        help=f"camera of the photo, or of all listed photos without one: {CAMERA_HELP}. Without "
        "it, the focal length of a single photo is estimated; its lens distortion must be small",
    )
    parser.add_argument(
        "--json", action="store_true", help="print everything about the one photo as JSON"
    )
    parser.add_argument(
        "--also",
        metavar="MAP",
        action="append",
        help="another map to look for the one photo in; may be repeated: the maps with the most "
        f"similar reference photos, {MAPS_TRIED} at most, are opened, until it is found",
    )
    parser.add_argument(
        "--memory",
        metavar="GB",
        type=float,
        help="with --also: maps that are held at a time, at most (default: all that are opened)",
    )
    parser.add_argument(
        "--prior",
        metavar="POSE",
        help='approximate pose of the one photo: "qw qx qy qz tx ty tz", world to camera',
    )
    parser.add_argument(
        "--prior-sigma",
        nargs=2,
        type=float,
        metavar=("LENGTH", "DEGREES"),
        help="standard deviations of the prior, or of all priors, in world units and degrees; with "
        "180 degrees, only the position is used "
        f"(default: {PosePrior.translation_sigma} {PosePrior.rotation_sigma_degrees})",
    )
    parser.add_argument(
        "--pictures",
        metavar="DIR",
        help="write photo, render and their difference side by side, a picture a photo",
    )
    many = parser.add_argument_group("many photos")
    many.add_argument(
        "--queries",
        metavar="FILE",
        help="lines of: name MODEL width height params; or of names alone, with --camera",
    )
    many.add_argument(
        "--images",
        metavar="QUERY_DIR",
        help="folder of the query photos; without --queries, all photos in it, with --camera",
    )
    many.add_argument("--output", metavar="POSES", help="poses: name qw qx qy qz tx ty tz")
    many.add_argument(
        "--coarse-output", metavar="POSES", help="the coarse poses, from matches alone"
    )
    many.add_argument(
        "--details",
        metavar="JSONL",
        help="one line per query with everything that is known (default: beside the output)",
    )
    many.add_argument(
        "--resume",
        action="store_true",
        help="continue an interrupted run: keep what the details already hold",
    )
    many.add_argument(
        "--priors",
        metavar="POSES",
        help="approximate poses: a file in any form that gscpe evaluate reads; photos that it "
        "lacks are localized without a prior",
    )
    add_workers(many)
    add_timeout(many)
    add_retrieval_model(parser)
    add_matcher(parser)
    add_backend(parser)
    parser.set_defaults(run=run, parser=parser)


def run(options: argparse.Namespace) -> int:
    parser: argparse.ArgumentParser = options.parser
    listed = options.queries is not None or (options.photo is None and options.images is not None)
    if (options.photo is None) != listed:
        parser.error(
            "give either one photo, or many: --queries with --images, or --images with --camera"
        )
    one = {"json", "prior", "also", "memory"}
    many = {
        *("images", "output", "coarse_output", "details"),
        *("resume", "priors", "workers", "scheduler", "timeout"),
    }
    alien = sorted(name for name in (one if listed else many) if getattr(options, name))
    if alien:
        option = "--" + alien[0].replace("_", "-")
        parser.error(f"{option} cannot be used with {'many photos' if listed else 'a photo'}")
    if not listed:
        if Path(options.photo).is_dir():
            parser.error(f"{options.photo} is a folder; give it as --images, with --camera")
        return _localize_photo(options)
    if options.images is None or options.output is None:
        parser.error("many photos need --images and --output")
    if options.queries is None and options.camera is None:
        parser.error("--images without --queries needs --camera, one for all photos")
    return _localize_queries(options)


def _localize_photo(options: argparse.Namespace) -> int:
    camera = None if options.camera is None else Camera.parse(options.camera)
    prior = _prior(options)
    photo = Path(options.photo)
    _check_pictures(options.pictures, photo.parent, [photo.name])
    one = OnePhoto.decode(photo_bytes(photo), photo, camera)
    if options.also:
        return _localize_in_several(options, one)
    if options.memory is not None:
        options.parser.error("--memory needs --also")
    with Localizer(
        open_map(options.map),
        LocalizerSettings(retrieval_model=options.retrieval_model),
        options.matcher,
        options.backend,
        show_progress(),
    ) as localizer:
        found = localize_one(localizer, one, prior)
        details = found.as_json()
        _write_picture(options, one, found, details, localizer)
    return _show(options, found, details, prior)


def _localize_in_several(options: argparse.Namespace, photo: OnePhoto) -> int:
    if options.prior is not None:
        options.parser.error("--prior belongs to one map, and --also names others")
    order = shelf_order(
        [options.map, *options.also],
        LocalizerSettings(retrieval_model=options.retrieval_model),
        options.matcher,
        options.backend,
        None if options.memory is None else int(1e9 * options.memory),
    )
    with Shelf(order) as shelf, Building(shelf) as building:
        placed = building.localize(photo)
        details = placed.as_json()
        _write_picture(options, photo, placed.found, details, shelf.localizer(placed.map))
    print(f"looked for in: {', '.join(placed.tried)}", file=sys.stderr)
    if placed.found.localized:
        print(f"found in {placed.map}", file=sys.stderr)
    return _show(options, placed.found, details, None)


def _write_picture(
    options: argparse.Namespace,
    photo: OnePhoto,
    found: OneResult,
    details: Mapping[str, Any],
    localizer: Localizer,
) -> None:
    if options.pictures is None or found.camera is None:
        return
    path = strip_path(Path(options.pictures), Path(options.photo).name)
    write_image(path, compare(details, photo.image, found.camera, localizer).strip())
    print(f"{path}: photo, render and difference", file=sys.stderr)


def _show(
    options: argparse.Namespace,
    found: OneResult,
    details: Mapping[str, Any],
    prior: PosePrior | None,
) -> int:
    """Prints the answer; the exit status."""
    if options.camera is None and found.camera is not None:
        text = found.camera.colmap_text().replace(" ", ",")
        print(f"camera estimated: {text}", file=sys.stderr)
    if prior is not None and details["started_from"] == "reference":
        print("the prior led to no pose; the reference photos did", file=sys.stderr)
    if options.json:
        print_json(details)
    elif found.localized:
        print(details["cam_from_world"], flush=True)
        if found.result is not None and found.result.covariance is not None:
            # Apart from the pose, which programs read.
            deviations = deviations_text(found.result.covariance)
            print(f"standard deviations: {deviations}", file=sys.stderr)
    else:
        print(f"{options.photo}: not localized: {found.reason}", file=sys.stderr)
    return 0 if found.localized else 1


def _prior(options: argparse.Namespace) -> PosePrior | None:
    if options.prior is None:
        if options.prior_sigma is not None:
            options.parser.error("--prior-sigma needs --prior")
        return None
    cam_from_world = parse_pose(options.prior)
    return PosePrior(cam_from_world, *(options.prior_sigma or ()))


def _localize_queries(options: argparse.Namespace) -> int:
    camera = None if options.camera is None else Camera.parse(options.camera)
    if not Path(options.images).is_dir():
        raise QueryListError(f"--images {options.images} is not a folder")
    if options.queries is not None:
        queries = read_query_list(options.queries, camera, options.images)
    else:
        assert camera is not None
        queries = folder_queries(options.images, camera)
    queries = fit_queries(queries, options.images)
    output = Path(options.output)
    if not output.name:
        raise OutputError(f"--output {output} is a folder; give a file for the poses")
    details_path = Path(options.details or output.with_suffix(".details.jsonl"))
    inputs = [given for given in (options.queries, options.priors) if given is not None]
    check_outputs([output, details_path, options.coarse_output], inputs)
    _check_pictures(options.pictures, Path(options.images), [query.name for query in queries])
    priors = _priors(options, queries)
    instructions = Instructions.of(
        options.map,
        options.images,
        LocalizerSettings(retrieval_model=options.retrieval_model),
        options.matcher,
        options.backend,
        priors,
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
    status = _summarize(details, output, details_path)
    if options.pictures is not None:
        _write_pictures(options, details)
    return status


def _check_pictures(pictures: str | None, images: Path, names: Sequence[str]) -> None:
    """Before any long work."""
    if pictures is None:
        return
    folder = Path(pictures)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"--pictures {folder} is no folder: {error.strerror}") from error
    for name in names:
        if strip_path(folder, name).resolve() == (images / name).resolve():
            raise OutputError(
                f"--pictures {folder} would overwrite the photo {name}; give another folder"
            )


def _write_pictures(options: argparse.Namespace, details: Sequence[Mapping[str, Any]]) -> None:
    """Of all photos that can be read; after the batch, whose workers have no part in it."""
    folder, images = Path(options.pictures), Path(options.images)
    written = 0
    with Localizer(
        open_map(options.map),
        LocalizerSettings(retrieval_model=options.retrieval_model),
        options.matcher,
        options.backend,
    ) as localizer:
        bar = tqdm(details, desc="pictures", disable=not show_progress())
        for detail in bar:
            if detail["status"] == "failed":
                continue
            name, camera = str(detail["name"]), Camera.parse(str(detail["camera"]))
            image = read_image_of(images / name, camera)
            write_image(strip_path(folder, name), compare(detail, image, camera, localizer).strip())
            written += 1
    print(f"{folder}: {written} pictures of photo, render and difference", file=sys.stderr)


def _priors(options: argparse.Namespace, queries: Sequence[Query]) -> dict[str, PosePrior]:
    if options.priors is None:
        if options.prior_sigma is not None:
            options.parser.error("--prior-sigma needs --priors, where there are --queries")
        return {}
    priors = read_priors(options.priors, queries, *(options.prior_sigma or ()))
    print(f"{len(priors)} of {len(queries)} photos have a prior", file=sys.stderr)
    return priors


def _summarize(details: Sequence[Mapping[str, Any]], output: Path, details_path: Path) -> int:
    localized = sum(detail["status"] == "localized" for detail in details)
    print(f"{localized} of {len(details)} photos localized: {output}; details: {details_path}")
    failed = [detail for detail in details if detail["status"] == "failed"]
    if failed:
        name, reason = str(failed[0]["name"]), str(failed[0]["reason"])
        first = reason if name in reason else f"{name}: {reason}"
        print(f"{len(failed)} photos could not be used, the first: {first}", file=sys.stderr)
    return 0 if localized else 1
