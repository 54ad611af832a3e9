# SPDX-License-Identifier: Apache-2.0
"""The kinds of data sets that ``gscpe benchmark`` reads, and what each must be told."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path
from typing import Sequence

from gscpe.datasets import (
    Dataset,
    cambridge,
    read_cambridge,
    read_colmap,
    read_fast_livo2,
    read_rgbd_folder,
    read_seven_scenes,
    read_transforms,
    seven_scenes,
)

_log = logging.getLogger(__name__)


def add_kinds(parser: argparse.ArgumentParser, common: argparse.ArgumentParser) -> None:
    """A subcommand a kind; ``options.read(options)`` reads its scenes."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")

    def add(name: str, what: str, about: str) -> argparse.ArgumentParser:
        kind = kinds.add_parser(
            name, parents=[common], help=about, description=f"{about}; see docs/datasets.md"
        )
        kind.add_argument("root", metavar=what)
        return kind

    kind = add("7scenes", "ROOT", "7-Scenes, with its own or the SfM ground truth")
    _add_scenes(kind, "redkitchen")
    kind.add_argument(
        "--ground-truth",
        choices=("sfm", "original"),
        default="sfm",
        help="which poses to use; the splat must be in their frame (default: %(default)s)",
    )
    kind.add_argument("--pgt", metavar="DIR", help="folder with SCENE_train.txt and SCENE_test.txt")
    kind.set_defaults(read=_read_seven_scenes)

    kind = add("cambridge", "ROOT", "Cambridge Landmarks")
    _add_scenes(kind, "KingsCollege")
    kind.set_defaults(read=_read_cambridge)

    kind = add("fast-livo2", "ROOT", "sequences of FAST-LIVO2")
    kind.add_argument("--scene", nargs="+", required=True, metavar="SCENE", help="folders in ROOT")
    kind.add_argument(
        "--time-offset",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="added to the photos' times (default: %(default)s)",
    )
    kind.set_defaults(read=_read_fast_livo2)

    kind = add("colmap", "MODEL_DIR", "any COLMAP model")
    kind.add_argument("--images", required=True, metavar="IMAGE_DIR", help="the model's photos")
    _add_every(kind)
    kind.add_argument("--test-list", metavar="FILE", help="names of the photos that are queries")
    kind.add_argument(
        "--queries",
        metavar="FILE",
        help="other photos are the queries: lines of name MODEL width height params",
    )
    kind.add_argument("--query-images", metavar="DIR", help="their folder (default: --images)")
    kind.add_argument("--truth", metavar="FILE", help="their poses: name qw qx qy qz tx ty tz")
    _add_unit(kind)
    kind.set_defaults(read=_read_colmap)

    kind = add("nerfstudio", "PATH", "a transforms.json, or the folder that holds it")
    _add_every(kind)
    _add_unit(kind)
    kind.set_defaults(read=_read_transforms)

    kind = add("rgbd", "ROOT", "a folder of RGB-D photos with poses, in metres")
    _add_every(kind)
    kind.set_defaults(read=_read_rgbd)


def _add_scenes(parser: argparse.ArgumentParser, example: str) -> None:
    parser.add_argument(
        "--scene",
        nargs="+",
        required=True,
        metavar="SCENE",
        help=f"one or more, for example {example}; or all",
    )


def _add_every(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--every", type=int, metavar="N", help="every N-th photo is a query (default: 8)"
    )


def _add_unit(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--metres-per-unit",
        type=float,
        metavar="METRES",
        help="length of a unit of the poses (default: unknown)",
    )


def _chosen(root: str, scenes: Sequence[str], known: Sequence[str]) -> Sequence[str]:
    """All: those that are there; if none is, the first, which the reader says is missing."""
    if list(scenes) != ["all"]:
        return list(dict.fromkeys(scenes))
    there = [scene for scene in known if (Path(root) / scene).is_dir()]
    missing = [scene for scene in known if scene not in there]
    if there and missing:
        _log.warning("%s has no folder %s; continuing without it", root, ", ".join(missing))
    return there or known[:1]


def _read_seven_scenes(options: argparse.Namespace) -> list[Dataset]:
    return [
        read_seven_scenes(options.root, scene, options.ground_truth, options.pgt)
        for scene in _chosen(options.root, options.scene, seven_scenes.SCENES)
    ]


def _read_cambridge(options: argparse.Namespace) -> list[Dataset]:
    scenes = _chosen(options.root, options.scene, cambridge.SCENES)
    return [read_cambridge(options.root, scene) for scene in scenes]


def _read_fast_livo2(options: argparse.Namespace) -> list[Dataset]:
    scenes = list(dict.fromkeys(options.scene))
    return [read_fast_livo2(options.root, scene, options.time_offset) for scene in scenes]


def _read_colmap(options: argparse.Namespace) -> list[Dataset]:
    return [
        read_colmap(
            options.root,
            options.images,
            options.every,
            options.test_list,
            options.queries,
            options.truth,
            options.query_images,
            options.metres_per_unit,
        )
    ]


def _read_transforms(options: argparse.Namespace) -> list[Dataset]:
    return [read_transforms(options.root, options.every, options.metres_per_unit)]


def _read_rgbd(options: argparse.Namespace) -> list[Dataset]:
    return [read_rgbd_folder(options.root, options.every)]
