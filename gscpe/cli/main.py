# SPDX-License-Identifier: Apache-2.0
"""``gscpe``: reads the arguments, runs a subcommand, and turns errors into one line."""

from __future__ import annotations

import argparse
import logging
import os
import sys
from typing import NoReturn, Sequence

from gscpe import __version__
from gscpe.cli import (
    benchmark,
    build_map,
    convert_poses,
    demo,
    doctor,
    evaluate,
    localize,
    make_map,
    models,
    reconstruct,
    render,
    serve,
    track,
    train,
    view,
)
from gscpe.cli.streams import log_to_stderr, say, usable_streams
from gscpe.errors import GscpeError, ran_out_of_memory
from gscpe.interrupts import Terminated, terminated_like_interrupts

_COMMANDS = (
    *(
        demo,
        make_map,
        reconstruct,
        train,
        build_map,
        localize,
        track,
        benchmark,
        evaluate,
        convert_poses,
        view,
        render,
        serve,
        models,
    ),
    doctor,
)

_SMALLER = "use fewer workers, smaller photos or a smaller map, or allow more memory"


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}; see {self.prog} --help\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line; the return value is the exit status: 0 done, 1 nothing was
    localized or something is missing, 2 bad input, 3 out of memory, 4 a map was written that is not
    good, 130 interrupted, 143 ended by SIGTERM."""
    with usable_streams():
        options = _parse(arguments)
        level = logging.DEBUG if options.verbose else logging.WARNING
        with log_to_stderr(level), terminated_like_interrupts():
            return _run(options)


def _run(options: argparse.Namespace) -> int:
    who = f"gscpe {options.command}"
    try:
        status = int(options.run(options))
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader has enough, as in: gscpe evaluate ... | head -1
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Terminated as end:
        say(f"{who}: {end}")
        return end.status
    except KeyboardInterrupt:
        say(f"{who}: interrupted")
        return 130
    except Exception as error:
        if ran_out_of_memory(error):
            what = _one_line(error)
            say(f"{who}: out of memory{f' ({what})' if what else ''}: {_SMALLER}")
            return 3
        # An OSError is what no typed error foresaw: a full disk, a name too long.
        if isinstance(error, (GscpeError, OSError)):
            say(f"{who}: {_one_line(error)}")
            return 2
        raise


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = _Parser(
        prog="gscpe", description="Find where a photo was taken, inside a 3D Gaussian splat."
    )
    parser.add_argument("--version", action="version", version=f"gscpe {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in _COMMANDS:
        command.add_parser(commands)
    for each in commands.choices.values():
        each.add_argument("-v", "--verbose", action="store_true", help="log progress")
    words = sys.argv[1:] if arguments is None else list(arguments)
    options = parser.parse_args(words)
    for word in words:
        if not word or (word.startswith("--") and word.endswith("=")):
            where = f"{word} has no value" if word else "an argument is empty"
            parser.error(f"{where}: is a variable not set?")
    return options


if __name__ == "__main__":
    sys.exit(main())
