# SPDX-License-Identifier: Apache-2.0
"""Text files as other systems write them."""

from __future__ import annotations

import codecs
from pathlib import Path

_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text_file(path: str | Path) -> str:
    """The text of a file in UTF-8, or in UTF-16 where its byte order mark says so (Windows'
    PowerShell and Notepad write that); without the mark.

    Bytes that are no UTF-8 are kept as Python keeps them in names of files (surrogate escapes):
    names of photos may have them.

    Raises:
        OSError: the file cannot be read.
        UnicodeDecodeError: it is no text.
    """
    data = Path(path).read_bytes()
    try:
        text = data.decode("utf-16" if data.startswith(_UTF16) else "utf-8-sig")
    except UnicodeDecodeError:
        ascii_bytes = len(data) - len(data.translate(None, bytes(range(128))))
        if b"\0" in data or 2 * ascii_bytes < len(data):
            raise
        text = data.decode("utf-8-sig", errors="surrogateescape")
    return text.replace("\r\n", "\n").replace("\r", "\n")
