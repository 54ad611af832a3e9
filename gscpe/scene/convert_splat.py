"""Converts a splat file to .ply with gaussforge; run as a program by splat_formats.

A process of its own, because damaged files can crash the library, and because what it
prints must not get into a caller's output. Arguments: kind, input, output. Prints
"antialiased" or "plain" as its last line; any failure ends with a status other than 0.
"""

import sys
from pathlib import Path

import gaussforge


def main(kind: str, source: str, target: str) -> None:
    data = Path(source).read_bytes()
    forge = gaussforge.GaussForge()
    ply = forge.convert(data, kind, "ply")["data"]
    antialiased = forge.get_model_info(data, kind)["data"]["rendering"]["antialiased"]
    Path(target).write_bytes(ply)
    print("\nantialiased" if antialiased else "\nplain")


if __name__ == "__main__":
    main(*sys.argv[1:])
