# SPDX-License-Identifier: Apache-2.0
"""``gscpe localize`` of one photo, in one map or in several."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Mapping

from gscpe.batch import Building, OnePhoto, OneResult, Shelf, localize_one
from gscpe.cli.common import (
    check_pictures,
    localizer_settings,
    print_json,
    shelf_order_of,
    show_progress,
)
from gscpe.cli.page import live_page, stay_after
from gscpe.geometry.camera import Camera
from gscpe.localization import Localizer, PosePrior
from gscpe.localization.result import deviations_text
from gscpe.photos import write_image
from gscpe.photos.image_file import photo_bytes
from gscpe.poses.hloc import parse_pose
from gscpe.report.comparison import compare, strip_path
from gscpe.scene import open_map


def localize_photo(options: argparse.Namespace) -> int:
    """Prints what is found; the exit status."""
    camera = None if options.camera is None else Camera.typed(options.camera)
    prior = _prior(options)
    photo = Path(options.photo)
    check_pictures(options.pictures, photo.parent, [photo.name])
    one = OnePhoto.decode(photo_bytes(photo), photo, camera)
    if options.also:
        return _localize_in_several(options, one)
    map_ = open_map(options.map)
    with (
        Localizer(
            map_,
            localizer_settings(options),
            options.matcher,
            options.backend,
            show_progress(),
        ) as localizer,
        live_page(options, map_, [Path()]) as page,
    ):
        found = localize_one(localizer, one, prior)
        details = found.as_json()
        _write_picture(options, one, found, details, localizer)
        status = _show(options, found, details, prior)
        if page is not None:
            page.add_detail(details)
            stay_after(page)
    return status


def _localize_in_several(options: argparse.Namespace, photo: OnePhoto) -> int:
    order = shelf_order_of(options, [options.map, *options.also])
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
        result = found.result
        if result is not None and result.covariance is not None:
            # Apart from the pose, which programs read.
            deviations = deviations_text(result.covariance, result.metres_per_unit)
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
