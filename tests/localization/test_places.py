# SPDX-License-Identifier: Apache-2.0
"""Which reference photos are tried, as a whole run with the default settings does it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import Localizer, LocalizerSettings, PosePrior
from gscpe.geometry import se3
from gscpe.photos import Photo
from gscpe.scene import Map, References

CAMERA = room_camera(240, 180)


def moved(metres: float, degrees: float) -> NDArray[np.float64]:
    """A camera beside the room's, turned about its own centre."""
    turned = se3.exp([0, 0, 0, 0, np.radians(degrees), 0]) @ ROOM_POSE
    turned[:3, 3] += [metres, 0, 0]
    return turned


def map_with(*others: NDArray[np.float64]) -> Map:
    """The room's map with further references: "0" is the room's own, "1" the first other."""
    known = room_map()
    poses = np.stack([ROOM_POSE, *others])
    names = tuple(str(i) for i in range(len(poses)))
    descriptors = np.repeat(known.descriptors.descriptors, len(poses), axis=0)
    return replace(
        known,
        references=References(names, poses, known.references.cameras * len(poses)),
        descriptors=replace(known.descriptors, descriptors=descriptors),
    )


def tried(map_: Map, prior: PosePrior | None = None, **settings: int) -> list[str | None]:
    """The references that a photo of another room is looked for at, in vain."""
    photo = room(9).shoot(CAMERA, ROOM_POSE).uint8
    with Localizer(map_, LocalizerSettings(**settings), "sift") as localizer:  # type: ignore[arg-type]
        result = localizer.localize(photo, CAMERA, prior, map_.references.names)
    assert not result.localized
    assert result.best in result.attempts
    return [attempt.start.reference for attempt in result.attempts]


@pytest.mark.parametrize(
    ("metres", "degrees", "expected"),
    [
        (0.4, 20.0, ["0"]),  # the same place
        (0.6, 0.0, ["0", "1"]),  # another place, ...
        (0.0, 45.0, ["0", "1"]),  # ... or another view of it
    ],
)
def test_one_reference_a_place(metres: float, degrees: float, expected: list[str]) -> None:
    assert tried(map_with(moved(metres, degrees))) == expected


def test_three_places_and_then_three_more() -> None:
    places = [moved(0.6 * i, 0.0) for i in range(1, 8)]
    assert tried(map_with(*places)) == ["0", "1", "2", "3", "4", "5"]
    assert tried(map_with(*places), more_places=0) == ["0", "1", "2"]


def test_an_unsure_prior_says_which_comes_first() -> None:
    """Three deviations and a place away from it at most; the others are tried after."""
    map_ = map_with(moved(1.2, 0.0), moved(2.4, 0.0))
    order = tried(map_, PosePrior(moved(2.0, 0.0), 0.2, 10.0))
    assert order == [None, "1", "2", "0"]
    assert tried(map_, PosePrior(moved(3.0, 0.0), 0.2, 10.0)) == [None, "2", "0", "1"]


def test_an_unsure_likeness_is_compared_with_other_places() -> None:
    """A photo of which half shows something else is recognized, but does not look enough like the
    map to do without the other places."""
    map_, beside = map_with(moved(0.6, 0.0)), moved(0.03, 1.0)
    photo = room().shoot(CAMERA, beside).uint8
    covered = photo.copy()
    covered[:, 120:] = room(9).shoot(CAMERA, ROOM_POSE).uint8[:, 120:]
    with Localizer(map_, matcher="sift") as localizer:
        whole, half = (
            localizer.localize(each, CAMERA, references=map_.references.names)
            for each in (photo, covered)
        )
    assert whole.localized
    assert half.localized, half.reason
    assert (len(whole.attempts), len(half.attempts)) == (1, 2)


@pytest.mark.parametrize(
    ("metres", "degrees", "expected"),
    [(0.09, 3.5, "tracking"), (0.15, 1.0, "prior"), (0.02, 6.0, "prior")],
)
def test_only_a_sure_prior_needs_no_matches(metres: float, degrees: float, expected: str) -> None:
    photo = room().shoot(CAMERA, ROOM_POSE).uint8
    with Localizer(room_map(), matcher="sift") as localizer:
        result = localizer.localize(photo, CAMERA, PosePrior(moved(0.02, 0.5), metres, degrees))
    assert result.localized
    assert result.started_from == expected


@pytest.mark.parametrize(("scale", "expected"), [(0.98, 0.98), (0.9, 1.0), (1.3, 1.0), (0.25, 0.5)])
def test_photos_come_to_the_references_resolution(scale: float, expected: float) -> None:
    """Not for a few per cent, and not by more than twice: there is nothing more in a thumbnail."""
    camera = CAMERA.resized(round(scale * CAMERA.width), round(scale * CAMERA.height))
    photo = Photo(np.zeros((camera.height, camera.width, 3), np.uint8), camera)
    with Localizer(room_map(), matcher="sift") as localizer:
        seen = localizer.at_the_maps_resolution(photo)
    assert seen.camera.fx == pytest.approx(expected * CAMERA.fx, rel=0.01)
    assert seen.rgb.shape == (seen.camera.height, seen.camera.width, 3)
