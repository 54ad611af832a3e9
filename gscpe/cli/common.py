# SPDX-License-Identifier: Apache-2.0
"""What several subcommands share."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Sequence

from gscpe.batch import TIMEOUT, ShelfOrder, shelf_order
from gscpe.errors import OutputError, SettingsError
from gscpe.given import real_path
from gscpe.localization import LocalizerSettings
from gscpe.report.comparison import strip_path

if TYPE_CHECKING:  # argparse keeps the class private
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]
else:
    Commands = Any

CAMERA_HELP = (
    "COLMAP camera, MODEL,width,height,params..., for example "
    "PINHOLE,640,480,525.5,525.5,320,240 (top-left pixel centre at 0.5, 0.5)"
)


def add_backend(parser: argparse.ArgumentParser) -> None:
    """``--backend``, for the commands that render."""
    parser.add_argument(
        "--backend",
        choices=("auto", "gl", "cpu"),
        default="auto",
        help="renderer: OpenGL, or the CPU with Numba (default: the faster one on this machine)",
    )


def add_matcher(parser: argparse.ArgumentParser) -> None:
    """``--matcher``, for the commands that localize."""
    parser.add_argument(
        "--matcher",
        metavar="NAME",
        default="auto",
        help="matcher of photo and render: sift, xfeat, xfeat+lighterglue, onnx:PATH, or auto "
        "(default: xfeat where it is installed, see gscpe models, else sift)",
    )


def add_localizing(parser: argparse.ArgumentParser) -> None:
    """``--retrieval-model``, ``--matcher`` and ``--backend``, for the commands that open maps to
    localize in."""
    parser.add_argument(
        "--retrieval-model",
        metavar="ONNX",
        help="the exported network that described the map's photos",
    )
    add_matcher(parser)
    add_backend(parser)


def add_workers(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """``--workers`` and ``--scheduler``, for the commands that localize lists; what they say is
    for :func:`gscpe.batch.make_crew`."""
    who = parser.add_mutually_exclusive_group()
    who.add_argument(
        "--workers",
        metavar="N",
        type=positive,
        help="number of worker processes, which share the cores (default: chosen for this machine)",
    )
    who.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="use the workers of this Dask scheduler, for example tcp://10.0.0.1:8786; they read "
        "the map and the photos from the same paths",
    )


def add_timeout(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """``--timeout``, beside :func:`add_workers`."""
    parser.add_argument(
        "--timeout",
        metavar="SECONDS",
        type=positive,
        help="a worker that needs longer for one photo is replaced, and the photo counts as "
        f"failed (default: {TIMEOUT:g}; not with one worker)",
    )


def positive(text: str) -> int:
    """A whole number above 0, for argparse."""
    if not (text.isdecimal() and int(text)):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return int(text)


def memory_bytes(options: argparse.Namespace) -> int | None:
    """What ``--memory GB`` allows; None where it was not given.

    Raises:
        SettingsError: it is not positive.
    """
    if options.memory is None:
        return None
    if not options.memory > 0:
        raise SettingsError(f"--memory must be positive, not {options.memory:g} GB")
    return int(min(1e9 * options.memory, 1e18))


def localizer_settings(options: argparse.Namespace) -> LocalizerSettings:
    """What ``--retrieval-model`` says."""
    return LocalizerSettings(retrieval_model=options.retrieval_model)


def shelf_order_of(options: argparse.Namespace, maps: Sequence[str]) -> ShelfOrder:
    """Several maps as ``--matcher``, ``--backend``, ``--memory`` and ``--retrieval-model`` say.

    Raises:
        GscpeError: as gscpe.batch.shelf_order and :func:`memory_bytes`.
    """
    return shelf_order(
        list(maps),
        localizer_settings(options),
        options.matcher,
        options.backend,
        memory_bytes(options),
    )


def check_pictures(pictures: str | None, images: Path, names: Sequence[str]) -> None:
    """Raises OutputError, before any long work, where ``--pictures`` is no folder, or one that
    photos would be overwritten in."""
    if pictures is None:
        return
    folder = Path(pictures)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"--pictures {folder} is no folder: {error.strerror}") from error
    for name in names:
        if real_path(strip_path(folder, name)) == real_path(images / name):
            raise OutputError(
                f"--pictures {folder} would overwrite the photo {name}; give another folder"
            )


def print_json(data: Any) -> None:
    """Prints data as JSON."""
    print(json.dumps(data, indent=2))


def show_progress() -> bool:
    """Progress bars are for people, not for log files."""
    return sys.stderr is not None and sys.stderr.isatty()
