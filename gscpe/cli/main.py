"""``gscpe``: reads the arguments, runs a subcommand, and turns errors into one line."""

from __future__ import annotations

import argparse
import logging
import sys
from typing import Sequence

from gscpe import __version__
from gscpe.cli import build_map, demo, doctor, evaluate, localize, render
from gscpe.errors import GscpeError

_COMMANDS = (demo, build_map, localize, evaluate, render, doctor)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line; the return value is the exit status: 0 done, 1 a photo was not
    localized or something is missing, 2 bad input, 130 interrupted."""
    parser = argparse.ArgumentParser(
        prog="gscpe",
        description="Find where a photo was taken, inside a 3D Gaussian splat.",
    )
    parser.add_argument("--version", action="version", version=f"gscpe {__version__}")
    parser.add_argument("-v", "--verbose", action="store_true", help="log what happens")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in _COMMANDS:
        command.add_parser(commands)
    options = parser.parse_args(arguments)
    logging.basicConfig(
        level=logging.DEBUG if options.verbose else logging.WARNING,
        format="%(name)s: %(message)s",
    )
    try:
        return int(options.run(options))
    except GscpeError as error:
        print(f"gscpe {options.command}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"\ngscpe {options.command}: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
