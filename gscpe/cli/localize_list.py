# SPDX-License-Identifier: Apache-2.0
"""``gscpe localize`` of a list of photos, in one map or in several."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Mapping, Sequence

from tqdm import tqdm

from gscpe.batch import (
    TIMEOUT,
    Instructions,
    ListFiles,
    Shelf,
    check_outputs,
    localize_to_files,
    map_path,
    named_maps,
    read_priors,
    refuse_details,
)
from gscpe.cli.common import (
    check_pictures,
    localizer_settings,
    memory_bytes,
    shelf_order_of,
    show_progress,
)
from gscpe.cli.folder_camera import estimated_camera
from gscpe.cli.page import live_page, stay_after
from gscpe.errors import OutputError, QueryListError
from gscpe.geometry.camera import Camera
from gscpe.localization import PosePrior
from gscpe.photos import read_image_of, write_image
from gscpe.report.comparison import compare, strip_path
from gscpe.scene import open_map
from gscpe.scene.query_list import Query, fit_queries, folder_queries, read_query_list


def localize_queries(options: argparse.Namespace) -> int:
    """Writes what is found; the exit status."""
    camera = None if options.camera is None else Camera.typed(options.camera)
    if not Path(options.images).is_dir():
        raise QueryListError(f"--images {options.images} is not a folder")
    if options.queries is not None:
        queries = read_query_list(options.queries, camera, options.images)
    else:
        queries = folder_queries(options.images, camera or estimated_camera(options))
    queries = fit_queries(queries, options.images)
    output = Path(options.output)
    if not output.name:
        raise OutputError(f"--output {output} is a folder; give a file for the poses")
    details_path = Path(options.details or output.with_suffix(".details.jsonl"))
    inputs = [given for given in (options.queries, options.priors) if given is not None]
    poses = [Path(path) for path in (output, options.coarse_output) if path is not None]
    if options.also is not None:
        names = named_maps([options.map, *options.also])
        poses = [map_path(path, name) for path in poses for name in names]
    refuse_details(poses)
    check_outputs([details_path, *poses], inputs)
    check_pictures(options.pictures, Path(options.images), [query.name for query in queries])
    priors = _priors(options, queries)
    instructions = Instructions.of(
        options.map,
        options.images,
        localizer_settings(options),
        options.matcher,
        options.backend,
        priors,
        options.timeout or TIMEOUT,
        options.also or (),
        memory_bytes(options),
    )
    coarse = None if options.coarse_output is None else Path(options.coarse_output)
    with ExitStack() as stack:
        page = None
        if options.view:
            map_ = open_map(options.map)
            page = stack.enter_context(live_page(options, map_, [options.images]))
        details, _ = localize_to_files(
            instructions,
            queries,
            ListFiles(details_path, output, coarse),
            options.workers,
            options.scheduler,
            options.resume,
            show_progress(),
            None if page is None else page.add_detail,
        )
        status = _summarize(details, instructions, output, details_path)
        if options.pictures is not None:
            _write_pictures(options, details)
        stay_after(page)
    return status


def _write_pictures(options: argparse.Namespace, details: Sequence[Mapping[str, Any]]) -> None:
    """Of all photos that can be read; after the batch, whose workers have no part in it."""
    folder, images = Path(options.pictures), Path(options.images)
    order = shelf_order_of(options, [options.map, *(options.also or ())])
    only = next(iter(order.folders))
    read = [detail for detail in details if detail["status"] != "failed"]
    read.sort(key=lambda detail: str(detail.get("map_name")))  # each map is opened once
    with Shelf(order) as shelf:
        for detail in tqdm(read, desc="pictures", disable=not show_progress()):
            name, camera = str(detail["name"]), Camera.parse(str(detail["camera"]))
            image = read_image_of(images / name, camera)
            localizer = shelf.localizer(detail.get("map_name", only))
            write_image(strip_path(folder, name), compare(detail, image, camera, localizer).strip())
    print(f"{folder}: {len(read)} pictures of photo, render and difference", file=sys.stderr)


def _priors(options: argparse.Namespace, queries: Sequence[Query]) -> dict[str, PosePrior]:
    if options.priors is None:
        if options.prior_sigma is not None:
            options.parser.error("--prior-sigma needs --priors, where there are --queries")
        return {}
    priors = read_priors(options.priors, queries, *(options.prior_sigma or ()))
    print(f"{len(priors)} of {len(queries)} photos have a prior", file=sys.stderr)
    return priors


def _summarize(
    details: Sequence[Mapping[str, Any]],
    instructions: Instructions,
    output: Path,
    details_path: Path,
) -> int:
    localized = sum(detail["status"] == "localized" for detail in details)
    where = str(output)
    if instructions.shelf is not None:
        where = f"{map_path(output, 'MAP')} of each MAP"
    print(f"{localized} of {len(details)} photos localized: {where}; details: {details_path}")
    for status, what in (("failed", "could not be used"), ("not localized", "not localized")):
        those = [detail for detail in details if detail["status"] == status]
        if those:
            name, reason = str(those[0]["name"]), str(those[0]["reason"])
            first = reason if name in reason else f"{name}: {reason}"
            count = f"{len(those)} {what}" + (", the first" if those[1:] else "")
            print(f"{count}: {first}", file=sys.stderr)
    return 0 if localized else 1
