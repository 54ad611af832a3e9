# SPDX-License-Identifier: Apache-2.0
"""``gscpe build-map --virtual-references``."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

from gscpe.cli.common import show_progress
from gscpe.geometry.camera import Camera
from gscpe.making import certify_virtual, write_certificate
from gscpe.mapping import MapSettings, map_with_virtual_references
from gscpe.scene import open_map, save_map
from gscpe.splats import GaussianScene
from gscpe.viewpoints import ViewpointSettings, find_viewpoints

NOT_GOOD = 4
"""Exit status: the map was written, but its references (or renders) do not come back to their own
poses."""


def from_splat_alone(
    scene: GaussianScene, settings: MapSettings, options: argparse.Namespace
) -> int:
    """Writes the map, certifies it by renders, and returns the exit status."""
    looked_for = ViewpointSettings(up=options.up)
    if options.camera is not None:
        looked_for = replace(looked_for, camera=Camera.typed(options.camera))
    found = find_viewpoints(scene, looked_for, options.backend, progress=show_progress())
    map_ = map_with_virtual_references(
        scene, settings, found, options.backend, progress=show_progress()
    )
    save_map(map_, options.output, compress=options.compress)
    up = ",".join(f"{x:.2f}" for x in found.up.round(2) + 0.0)  # no -0.00
    print(f"{options.output}: {len(scene)} Gaussians, {map_.references.count_text()}, no photos")
    if options.up is None:
        print(f"up was taken to be {up}; if that is wrong, give --up=X,Y,Z")
    return 0 if options.no_check else _certify(options)


def _certify(options: argparse.Namespace) -> int:
    """Localizes renders, since there are no photos; the certificate is kept in the map."""
    certificate = certify_virtual(
        open_map(options.output), backend=options.backend, progress=show_progress()
    )
    write_certificate(options.output, certificate)
    if certificate.verdict == "good":
        print(certificate.explanation())
        return 0
    print(f"gscpe build-map: {options.output}: {certificate.explanation()}", file=sys.stderr)
    if lost := [photo for photo in certificate.photos if photo.reason is not None]:
        print(f"{lost[0].name}, for example: {lost[0].reason}", file=sys.stderr)
    return NOT_GOOD if certificate.verdict == "poor" else 0
