# SPDX-License-Identifier: Apache-2.0
"""Localizers of several maps, as many as the memory holds: the one that was not used for the
longest time makes room for another."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Mapping

from gscpe.batch.fingerprint import map_fingerprint
from gscpe.closing import Closing
from gscpe.errors import MapError
from gscpe.given import parse_json, real_path
from gscpe.localization import Localizer, LocalizerSettings
from gscpe.matching import matcher_name
from gscpe.matching.choose import ONNX
from gscpe.scene import open_map

BYTES_A_GAUSSIAN = 1000
"""Memory of a localizer on the CPU, rounded up from what tools/bench_batch.py measures."""


@dataclass(frozen=True)
class ShelfOrder:
    """What a shelf opens, as small picklable data.

    Attributes:
        folders: of the maps, by name; absolute.
        fingerprints: of the maps as they were when the order was given.
        settings, matcher, backend: of the localizers.
        memory: bytes that all maps may take together (estimated from their numbers of
            Gaussians); one is always held. None: all are.
    """

    folders: Mapping[str, Path]
    fingerprints: Mapping[str, str]
    settings: LocalizerSettings
    matcher: str
    backend: str
    memory: int | None = None


def shelf_order(
    folders: list[str],
    settings: LocalizerSettings | None = None,
    matcher: str = "auto",
    backend: str = "auto",
    memory: int | None = None,
) -> ShelfOrder:
    """An order of the maps as they are now.

    Args:
        folders: of the maps.
        settings, matcher, backend: of the localizers; the matcher by its name.
        memory: see :class:`ShelfOrder`.

    Raises:
        MapError: a folder is no map, or two have the same name.
        ModelError, SettingsError: the matcher is none.
    """
    named = named_maps(folders)
    return ShelfOrder(
        folders=named,
        fingerprints={name: map_fingerprint(folder) for name, folder in named.items()},
        settings=settings or LocalizerSettings(),
        matcher=chosen_matcher(matcher),
        backend=backend,
        memory=memory,
    )


def chosen_matcher(matcher: str) -> str:
    """The name that "auto" stands for here, and the absolute path of an ONNX matcher: the same for
    all who open maps, wherever they are started.

    Raises:
        SettingsError: there is no such matcher.
    """
    if matcher.startswith(ONNX):
        return f"{ONNX}{Path(matcher.removeprefix(ONNX)).absolute()}"
    return matcher_name(matcher)


def named_maps(folders: list[str]) -> dict[str, Path]:
    """Absolute folders by name, the last part of their path without ``.gsmap``.

    Raises:
        MapError: a map is given twice, two have the same name, or one has none.
    """
    named: dict[str, Path] = {}
    for folder in folders:
        path = Path(folder).absolute()
        name = path.name.removesuffix(".gsmap")
        if not name:
            raise MapError(f"{folder} is no name of a map")
        if name in named:
            if real_path(path) == real_path(named[name]):
                raise MapError(f"map {folder} is given twice")
            raise MapError(f"{folder} and {named[name]} have the same name; rename one of them")
        named[name] = path
    return named


class Shelf(Closing):
    """Opens maps when they are needed.

    Args:
        order: what to open; it is kept.
    """

    def __init__(self, order: ShelfOrder) -> None:
        self.order = order
        self._open: OrderedDict[str, Localizer] = OrderedDict()

    @property
    def held(self) -> tuple[str, ...]:
        """Names of the maps that are open, the one last used last."""
        return tuple(self._open)

    def localizer(self, name: str) -> Localizer:
        """The localizer of a map, which is opened where it is not yet.

        Raises:
            MapError: the map is missing, damaged, or has changed since the order was given.
            GscpeError: as :class:`gscpe.Localizer`.
        """
        if name in self._open:
            self._open.move_to_end(name)
            return self._open[name]
        order, folder = self.order, self.order.folders[name]
        if map_fingerprint(folder) != order.fingerprints[name]:
            raise MapError(f"map {folder} has changed since the start; start again")
        self._make_room(map_bytes(folder))
        localizer = Localizer(open_map(folder), order.settings, order.matcher, order.backend)
        self._open[name] = localizer
        return localizer

    def _make_room(self, needed: int) -> None:
        if self.order.memory is None:
            return
        while self._open and needed + self._taken() > self.order.memory:
            _, oldest = self._open.popitem(last=False)
            oldest.close()

    def _taken(self) -> int:
        return sum(map_bytes(self.order.folders[name]) for name in self._open)

    def close(self) -> None:
        while self._open:
            self._open.popitem()[1].close()


def map_bytes(folder: Path) -> int:
    """Memory that a localizer of this map takes, about.

    Raises:
        MapError: its ``map.json`` is missing or damaged.
    """
    path = folder / "map.json"
    try:
        return BYTES_A_GAUSSIAN * int(parse_json(path.read_text())["gaussians"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MapError(f"{path} is damaged; build the map again") from error


def shelf_bytes(order: ShelfOrder) -> int:
    """Memory that the maps of a shelf take at most, about; the largest one always fits.

    Raises:
        MapError: the ``map.json`` of one is missing or damaged.
    """
    sizes = [map_bytes(folder) for folder in order.folders.values()]
    return sum(sizes) if order.memory is None else max(*sizes, min(order.memory, sum(sizes)))
