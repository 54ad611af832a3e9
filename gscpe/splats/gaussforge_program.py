# SPDX-License-Identifier: Apache-2.0
"""Converts a splat file with gaussforge; run as a program by through_gaussforge.

A process of its own, because damaged files can crash the library, and because what it
prints must not get into a caller's output. Arguments: kind of the input, kind of the
output, input, output. Prints "antialiased" or "plain", of the input, as its last line; any
failure ends with a status other than 0.
"""

import contextlib
import sys
from pathlib import Path

import gaussforge

SPZ_VERSION = 3  # gzip; later ones need zstd, which other programs read less often


# A damaged header may claim any number of Gaussians. A real file needs about 1 kB of memory
# for each, of which it takes at least 10 bytes, and the interpreter less than 2 GB.
MEMORY_BYTES, MEMORY_PER_BYTE = 2 * 2**30, 200


def limit_memory(file_size: int) -> None:
    """Makes larger allocations fail, where the system can do that (Linux)."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        limit = MEMORY_BYTES + MEMORY_PER_BYTE * file_size
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def main(source_kind: str, target_kind: str, source: str, target: str) -> None:
    data = Path(source).read_bytes()
    limit_memory(len(data))
    forge = gaussforge.GaussForge()
    converted = forge.convert(data, source_kind, target_kind, spz_version=SPZ_VERSION)["data"]
    antialiased = False  # a .ply may be tagged, but gaussforge does not see it
    if source_kind != "ply":
        info = forge.get_model_info(data, source_kind)["data"]
        antialiased = info["rendering"]["antialiased"]
    Path(target).write_bytes(converted)
    print("\nantialiased" if antialiased else "\nplain")


if __name__ == "__main__":
    main(*sys.argv[1:])
