"""``gscpe``: reads the arguments, runs a subcommand, and turns errors into one line."""

from __future__ import annotations

import argparse
import logging
import os
import sys
from typing import NoReturn, Sequence

import cv2

from gscpe import __version__
from gscpe.cli import (
    benchmark,
    build_map,
    convert_poses,
    demo,
    doctor,
    evaluate,
    localize,
    models,
    render,
)
from gscpe.errors import GscpeError

_COMMANDS = (demo, build_map, localize, benchmark, evaluate, convert_poses, render, models, doctor)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}; see {self.prog} --help\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line; the return value is the exit status: 0 done, 1 nothing was
    localized or something is missing, 2 bad input, 4 a map was written that is not good,
    130 interrupted."""
    options = _parse(arguments)
    _log_to_stderr(logging.DEBUG if options.verbose else logging.WARNING)
    try:
        status = int(options.run(options))
        sys.stdout.flush()
        return status
    except GscpeError as error:
        print(f"gscpe {options.command}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader has enough, as in: gscpe evaluate ... | head -1
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # what no typed error foresaw: a full disk, a name too long
        print(f"gscpe {options.command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"gscpe {options.command}: interrupted", file=sys.stderr)
        return 130


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = _Parser(
        prog="gscpe", description="Find where a photo was taken, inside a 3D Gaussian splat."
    )
    parser.add_argument("--version", action="version", version=f"gscpe {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in _COMMANDS:
        command.add_parser(commands)
    for each in commands.choices.values():
        each.add_argument("-v", "--verbose", action="store_true", help="log what happens")
    return parser.parse_args(arguments)


def _log_to_stderr(level: int) -> None:
    """gscpe's own messages; those of the libraries below it would only disturb."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    logger = logging.getLogger("gscpe")
    logger.handlers = [handler]
    logger.setLevel(level)
    logger.propagate = False
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


if __name__ == "__main__":
    sys.exit(main())
