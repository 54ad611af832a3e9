# SPDX-License-Identifier: Apache-2.0
"""SOG as folders: one splat (``meta.json`` and its images), or one in chunks and levels of detail.

Source: PlayCanvas's descriptions of SOG and of Streamed SOG, version 1
(developer.playcanvas.com). A leaf of ``lod-meta.json``'s tree names, for each level that it
has, a chunk and the Gaussians in it; level 0 is the finest.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Iterator

from gscpe.errors import SplatError
from gscpe.given import parse_json


@dataclass(frozen=True)
class Chunk:
    """Part of a splat in levels of detail.

    Attributes:
        meta: its ``meta.json``.
        rows: of its Gaussians, (begin, end) each; None for all.
    """

    meta: Path
    rows: tuple[tuple[int, int], ...] | None


def bundled(meta: Path, data: bytes) -> bytes:
    """A folder's ``meta.json``, with the images that it names, as the bytes of a ``.sog``.

    Raises:
        SplatError: it is not SOG's, or an image is missing.
    """
    content = _parsed(meta, data)
    if not isinstance(content.get("means"), dict):
        raise SplatError(
            f"{meta} is not the meta.json of a SOG splat: it has no means; give the splat's file"
        )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for section in content.values():
            for name in section.get("files", ()) if isinstance(section, dict) else ():
                archive.writestr(str(name), _image(meta, str(name)))
        archive.writestr("meta.json", data)
    return buffer.getvalue()


def finest_chunks(lod_meta: Path, data: bytes) -> tuple[Chunk, ...]:
    """The chunks that make up the splat at its finest, the environment among them.

    Raises:
        SplatError: the file is not Streamed SOG's.
    """
    content = _parsed(lod_meta, data)
    try:
        names = [str(name) for name in content["filenames"]]
        rows: dict[int, list[tuple[int, int]]] = {}
        for levels in _leaves(content["tree"]):
            part = levels[min(levels, key=int)]
            begin = int(part["offset"])
            rows.setdefault(int(part["file"]), []).append((begin, begin + int(part["count"])))
        chunks = [
            Chunk(lod_meta.parent / names[i], tuple(sorted(parts))) for i, parts in rows.items()
        ]
        if content.get("environment"):
            chunks.append(Chunk(lod_meta.parent / str(content["environment"]), None))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as error:
        raise SplatError(
            f"{lod_meta} is not the lod-meta.json of a splat in levels of detail (damaged?); "
            "convert it to .ply with splat-transform, or copy it again"
        ) from error
    nested = [chunk.meta for chunk in chunks if chunk.meta.name.lower().startswith("lod")]
    if nested:
        raise SplatError(f"{lod_meta} names {nested[0]}, which is no chunk; export it again")
    if not chunks:
        raise SplatError(f"{lod_meta} names no chunks: the splat is empty; export it again")
    return tuple(chunks)


def _leaves(node: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The levels of each leaf."""
    if node.get("lods"):
        yield node["lods"]
    for child in node.get("children") or ():
        yield from _leaves(child)


def _parsed(path: Path, data: bytes) -> dict[str, Any]:
    try:
        content = parse_json(data)
    except ValueError as error:
        raise SplatError(f"{path} is damaged: it is not JSON; copy it again") from error
    if not isinstance(content, dict):
        raise SplatError(f"{path} is not the meta.json of a SOG splat; give the splat's file")
    return content


def _image(meta: Path, name: str) -> bytes:
    if Path(name).name != name:
        raise SplatError(f"{meta} names {name!r}, which is not a file beside it")
    try:
        return (meta.parent / name).read_bytes()
    except OSError as error:
        raise SplatError(
            f"{meta} names {name}, which is not beside it; copy the whole folder, or pack it as "
            "one .sog with splat-transform"
        ) from error
