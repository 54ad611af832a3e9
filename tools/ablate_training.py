#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What each choice of the training does to localization: trains splats of one scene in several
ways, and localizes photos that none of them has seen.

Usage: GSCPE_DATA=DATA .venv/bin/python tools/ablate_training.py --work DIR
       .venv/bin/python tools/ablate_training.py --colmap MODEL --images PHOTOS --work DIR

Without --colmap the scene is RedKitchen: five blocks of five consecutive references are left out
and localized (with --queries reported its 100 queries are, and all references are learned from).
Of any other scene, every eighth photo is left out. All photos are first made smaller (--max-size).

--refined-model: another COLMAP model of the same photos, in the same frame. One more splat is
trained with its poses, and this one and the default are compared with the poses of both.

Tables are printed, and written into DIR as tables.txt, .md, .tex, .json and .html. What is finished
stays in DIR: the same command goes on where it was interrupted, and trains what is new or changed
(changes of the code it does not notice: take another DIR then).
"""

from __future__ import annotations

import argparse
import hashlib
import html
import json
import sys
import time
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np
from _common import redkitchen
from ablation_scene import GIVEN, REFINED, Scene, colmap_scene, redkitchen_scene

from gscpe import read_splat
from gscpe.errors import GscpeError
from gscpe.evaluation.table import Table, to_json, to_latex, to_markdown, to_text
from gscpe.evaluation.text import number_text, share_text
from gscpe.making.certificate import Certificate
from gscpe.making.certify import certify
from gscpe.making.settings import CertificateSettings
from gscpe.photos.photo import resized_photo
from gscpe.scene import Map
from gscpe.splats import write_splat
from gscpe.training import ProgressBar, TrainingSettings, train


@dataclass(frozen=True)
class Variant:
    """One way to train: with photos of ``scale`` times the size, and poses ``of`` a model."""

    name: str
    settings: TrainingSettings
    scale: float = 1.0
    of: str = GIVEN


def variants(full: TrainingSettings, refined: bool) -> list[Variant]:
    """The default first; each other one differs from it in one thing."""
    return [
        Variant("default", full),
        *([Variant("refined poses", full, of=REFINED)] if refined else []),
        Variant("without exposures", replace(full, exposure_rate=0.0)),
        Variant("antialiased", replace(full, antialiased=not full.antialiased)),
        Variant("without depths", replace(full, depth_weight=0.0)),
        Variant("depths count 3x", replace(full, depth_weight=3 * full.depth_weight)),
        Variant("half the Gaussians", replace(full, max_gaussians=full.max_gaussians // 2)),
        Variant("2.5x the Gaussians", replace(full, max_gaussians=full.max_gaussians * 5 // 2)),
        Variant("harmonics of degree 0", replace(full, sh_degree=0)),
        Variant("harmonics of degree 1", replace(full, sh_degree=1)),
        Variant("photos of half the size", full, scale=0.5),
        Variant("without densification", replace(full, least_growth=0.0, most_growth=0.0)),
    ]


def measure(scene: Scene, variant: Variant, work: Path) -> dict[str, Any]:
    """Trains and localizes, or reads what that gave before."""
    truths = scene.truths if variant.name in ("default", "refined poses") else (GIVEN,)
    learned = scene.with_poses(scene.learned, variant.of)
    points, seen = scene.points(variant.of)
    mark = hashlib.sha256(json.dumps(asdict(variant), sort_keys=True).encode())
    mark.update(repr((scene.learned.names, scene.queries.names, scene.size, truths)).encode())
    known = [scene.with_poses(scene.queries, truth).cam_from_world for truth in truths]
    for array in (learned.cam_from_world, points.positions, *seen, *known):
        mark.update(np.ascontiguousarray(array).tobytes())
    file = work / f"{variant.name.replace(' ', '-')}-{mark.hexdigest()[:12]}.json"
    if file.exists():
        return dict(json.loads(file.read_text(encoding="utf-8")))
    splat, photos = file.with_suffix(".ply"), scene.photos
    if variant.scale < 1.0:
        photos = [resized_photo(photo, variant.scale) for photo in photos]
    clocks = time.perf_counter(), time.process_time()
    with closing(ProgressBar()) as bar:
        poses = learned.cam_from_world
        trained = train(photos, poses, points, variant.settings, bar, seen=seen)
    seconds, processor = time.perf_counter() - clocks[0], time.process_time() - clocks[1]
    write_splat(trained, splat)
    map_ = Map.of(read_splat(splat), learned, scene.descriptors, scene.metres_per_unit)
    found: dict[str, Any] = {"seconds": seconds, "processor_seconds": processor, "truths": {}}
    for truth in truths:
        queries = scene.with_poses(scene.queries, truth)
        settings = CertificateSettings(pictures=0)
        certificate, _ = certify(map_, queries, scene.folder, settings, progress=True)
        found["truths"][truth] = summary(certificate)
    file.write_text(json.dumps(found, indent=1), encoding="utf-8")
    return found


def summary(certificate: Certificate) -> dict[str, float]:
    """Errors of photos that are not localized are infinite, for quantiles over all."""
    errors = np.array(
        [
            (np.inf, np.inf) if p.distance is None else (p.distance, p.degrees)
            for p in certificate.photos
        ]
    )
    high = np.quantile(errors, 0.9, axis=0, method="higher")
    return {
        "gaussians": certificate.gaussians,
        "psnr": certificate.mean("psnr"),
        "fitted_psnr": certificate.mean("fitted_psnr"),
        "localized": certificate.localized,
        "photos": len(certificate.photos),
        "scene_size": certificate.scene_size,
        "median_distance": certificate.median_distance,
        "median_degrees": certificate.median_degrees,
        "high_distance": float(high[0]),
        "high_degrees": float(high[1]),
    }


def table_of(scene: Scene, title: str, found: Mapping[str, Mapping[str, Any]]) -> Table:
    """A row a variant and truth."""
    metric = scene.metres_per_unit is not None
    unit = "cm" if metric else "% of the scene"
    rows, records = [], []
    for name, result in found.items():
        for truth, s in result["truths"].items():
            scale = 100.0 if metric else 100.0 / s["scene_size"]
            label = name if truth == GIVEN else f"{name}; from refined poses"
            rows.append(
                (
                    label, f"{s['gaussians']:.0f}", number_text(s["psnr"], 2),
                    number_text(s["fitted_psnr"], 2), share_text(s["localized"]),
                    number_text(scale * s["median_distance"], 3),
                    number_text(s["median_degrees"], 3),
                    number_text(scale * s["high_distance"], 3), number_text(s["high_degrees"], 3),
                    f"{result['seconds']:.0f}", f"{result['processor_seconds']:.0f}",
                )
            )  # fmt: skip
            seconds = {key: value for key, value in result.items() if key != "truths"}
            records.append({"variant": name, "truth": truth, **seconds, **s})
    header = (
        "", "Gaussians", "PSNR (dB)", "fitted", "localized", f"median ({unit})", "median (°)",
        f"90% ({unit})", "90% (°)", "s", "processor s",
    )  # fmt: skip
    notes = (
        "Errors of the final poses of photos left out; medians are of those localized, 90% of all. "
        "PSNR at their given poses, raw and with a gain and a bias fitted. Seconds of training.",
    )
    return Table(title, header, tuple(rows), notes, tuple(records))


def to_html(tables: Sequence[Table]) -> str:
    """A plain page."""
    parts = ["<!DOCTYPE html><meta charset=utf-8><title>Ablation of the training</title>"]
    parts.append("<style>td{text-align:right}td:first-child{text-align:left}</style>")
    for table in tables:
        parts.append(f"<table><caption>{html.escape(table.title)}</caption>")
        for row, tag in ((table.header, "th"), *((row, "td") for row in table.rows)):
            cells = "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row)
            parts.append(f"<tr>{cells}</tr>")
        parts += ["</table>", *(f"<p>{html.escape(note)}</p>" for note in table.notes)]
    return "\n".join(parts) + "\n"


def write_tables(tables: Sequence[Table], folder: Path) -> None:
    writers = {"txt": to_text, "md": to_markdown, "tex": to_latex, "json": to_json, "html": to_html}
    for ending, write in writers.items():
        (folder / f"tables.{ending}").write_text(write(tables), encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--work", type=Path, required=True, help="folder for all that is made")
    parser.add_argument("--colmap", type=Path, help="a COLMAP model, for another scene")
    parser.add_argument("--images", type=Path, help="its photos")
    parser.add_argument("--name", help="of that scene")
    parser.add_argument("--refined-model", type=Path, help="the same photos with other poses")
    parser.add_argument("--queries", choices=("references", "reported"), default="references")
    parser.add_argument("--iterations", type=int, default=4000, help="(default: %(default)s)")
    parser.add_argument("--max-size", type=int, default=320, help="pixels (default: %(default)s)")
    parser.add_argument("--gaussians", type=int, default=100_000, help="(default: %(default)s)")
    parser.add_argument("--only", nargs="+", metavar="VARIANT", help="some, by name")
    options = parser.parse_args()
    if (options.colmap is None) != (options.images is None):
        parser.error("--colmap and --images belong together")
    full = TrainingSettings(iterations=options.iterations, max_gaussians=options.gaussians)
    chosen = variants(full, options.refined_model is not None)
    unknown = {*(options.only or ())} - {variant.name for variant in chosen}
    if unknown:
        parser.error(f"no variant {min(unknown)!r}; there are {', '.join(v.name for v in chosen)}")
    chosen = [v for v in chosen if not options.only or v.name in options.only]
    try:
        where = options.refined_model, options.max_size, options.work
        if options.colmap is None:
            scene = redkitchen_scene(redkitchen(), options.queries == "reported", *where)
        else:
            name = options.name or options.images.resolve().parent.name
            scene = colmap_scene(name, options.colmap, options.images, *where)
        title = (
            f"{scene.name}: {len(scene.learned)} photos of {options.max_size} pixels learned from "
            f"in {options.iterations} iterations, {len(scene.queries)} localized"
        )
        found: dict[str, Mapping[str, Any]] = {}
        for number, variant in enumerate(chosen, start=1):
            print(f"{number}/{len(chosen)}: {variant.name}", file=sys.stderr)
            found[variant.name] = measure(scene, variant, options.work)
            tables = [table_of(scene, title, found)]
            write_tables(tables, options.work)
    except GscpeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(to_text(tables), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
