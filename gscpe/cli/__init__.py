# SPDX-License-Identifier: Apache-2.0
"""The command line: one file a subcommand, thin."""

import os
import sys


def main() -> int:
    """``gscpe``; interrupted while it still imports what it needs, it ends quietly too."""
    _fill_closed_descriptors()
    try:
        from gscpe.cli.main import main as run

        return run()
    except KeyboardInterrupt:
        if sys.stderr is not None:
            print("gscpe: interrupted", file=sys.stderr)
        return 130


def _fill_closed_descriptors() -> None:
    """Standard descriptors that are closed (``>&-``, some services) lead nowhere from now on: a
    file that is opened would else get their number, and what libraries print."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
            os.set_inheritable(number, True)  # worker processes have the same need
