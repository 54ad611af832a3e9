# SPDX-License-Identifier: Apache-2.0
"""Which photos tools/bench_trust.py localizes in which map."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Mapping, Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.poses import read_pose_file
from gscpe.scene.query_list import Query, read_query_list

HALVES = ("even", "odd")
"""Reported, and for choosing settings."""
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True, eq=False)
class Place:
    """Photos of one place, and perhaps a map of it."""

    name: str
    map: Path | None
    images: Path
    queries: tuple[Query, ...]
    truth: Mapping[str, Float64Array]


@dataclass(frozen=True, eq=False)
class Job:
    """One photo to localize in one map.

    Attributes:
        place: whose map.
        photos: the place that the photo shows.
        query: the photo.
        camera: "given", or "estimated" from the photo alone.
        half: "odd" or "even", see :func:`halves`.
    """

    place: Place
    photos: Place
    query: Query
    camera: str
    half: str

    @property
    def key(self) -> tuple[str, str, str, str]:
        return self.place.name, self.photos.name, self.query.name, self.camera


def read_places(path: Path) -> list[Place]:
    folder = path.resolve().parent
    return [
        Place(
            entry["name"],
            folder / entry["map"] if "map" in entry else None,
            folder / entry["images"],
            read_query_list(folder / entry["queries"]),
            read_pose_file(folder / entry["truth"]).poses if "truth" in entry else {},
        )
        for entry in tomllib.loads(path.read_text())["place"]
    ]


def spread(count: int, number: int) -> list[int]:
    """So many of ``range(count)``, spread evenly; fewer of them are always some of more."""
    return sorted(range(count), key=lambda i: (i * _GOLDEN) % 1.0)[:number]


def jobs_of(
    places: Sequence[Place], right: int, estimated: int, foreign: int, half: str | None = None
) -> list[Job]:
    """Those of the maps in turns, so that an interrupted run has seen something of each."""
    by_map: list[list[Job]] = []
    for place in places:
        if place.map is None:
            continue
        own = [i for i in of_half(place, half) if place.queries[i].name in place.truth]
        queues = [
            [job(place, place, own[i], camera) for i in spread(len(own), number)]
            for number, camera in ((right, "given"), (estimated, "estimated"))
        ]
        for other in places:
            if other is not place:
                theirs = of_half(other, half)
                chosen = spread(len(theirs), foreign)
                queues.append([job(place, other, theirs[i], "given") for i in chosen])
        by_map.append(in_turns(queues))
    return in_turns(by_map)


def halves(place: Place) -> list[str]:
    """Of each photo, by its number among those with a true pose, or among the others: where a map
    leaves out every eighth photo, their numbers in the list are all of one kind."""
    counts = {True: 0, False: 0}
    found = []
    for query in place.queries:
        known = query.name in place.truth
        found.append(HALVES[counts[known] % 2])
        counts[known] += 1
    return found


def of_half(place: Place, half: str | None) -> list[int]:
    """Numbers of the place's photos of this half, or of all."""
    return [i for i, its in enumerate(halves(place)) if half in (None, its)]


def in_turns(queues: Sequence[Sequence[Job]]) -> list[Job]:
    """The first of each queue, then the second of each."""
    return [each for turn in zip_longest(*queues) for each in turn if each is not None]


def job(place: Place, photos: Place, index: int, camera: str) -> Job:
    return Job(place, photos, photos.queries[index], camera, halves(photos)[index])
