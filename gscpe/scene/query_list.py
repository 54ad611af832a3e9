"""Lists of query photos in hloc's form: ``name MODEL width height params...``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gscpe.errors import CameraError, QueryListError
from gscpe.geometry.camera import Camera


@dataclass(frozen=True)
class Query:
    """A query photo: its name, relative to the image folder, and its camera."""

    name: str
    camera: Camera


def read_query_list(path: str | Path) -> tuple[Query, ...]:
    """The queries of a list, in its order.

    Raises:
        QueryListError: the file cannot be read, is empty, a line has another form, or a
            name comes twice.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise QueryListError(f"query list {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise QueryListError(f"{path} is not a text file of queries") from error
    queries: dict[str, Query] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        name, *camera = line.split(maxsplit=1)
        try:
            query = Query(name, Camera.parse(" ".join(camera)))
        except CameraError as error:
            raise QueryListError(f"{path}, line {number}: {error}") from None
        if name in queries:
            raise QueryListError(f"{path}, line {number}: {name} is in the list already")
        queries[name] = query
    if not queries:
        raise QueryListError(f"query list {path} is empty; expected name MODEL width height params")
    return tuple(queries.values())
