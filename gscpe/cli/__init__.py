"""The command line: one file a subcommand, thin."""

import sys


def main() -> int:
    """``gscpe``; interrupted while it still imports what it needs, it ends quietly too."""
    try:
        from gscpe.cli.main import main as run

        return run()
    except KeyboardInterrupt:
        print("gscpe: interrupted", file=sys.stderr)
        return 130
