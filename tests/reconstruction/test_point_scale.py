# SPDX-License-Identifier: Apache-2.0
"""The unit of a model from a length that its photos show."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray
from walks import walk_poses

from gscpe.errors import ReconstructionError, SettingsError
from gscpe.reconstruction.lengths import KnownLengths, read_lengths
from gscpe.reconstruction.point_scale import scaled_by_points
from gscpe.reconstruction.scale import ScaleSource

CAMERA = pycolmap.Camera(
    model="SIMPLE_RADIAL", width=500, height=375, params=[430.0, 250.0, 187.5, -0.08]
)
POINTS = {  # in front of the walk, metres
    "left": np.array([-0.4, 0.3, 2.5]),
    "right": np.array([0.3, 0.2, 2.2]),
    "top": np.array([0.1, -0.6, 2.8]),
}
UNIT = 0.37  # metres
NAMES = ("IMG 0.jpg", "IMG 1.HEIC.jpg", "IMG 2.jpg", "IMG 3.jpg")
FULL = (4000, 3000)  # of all photos but the last


def model() -> Any:
    """The photos of a walk, in units of its own."""
    images = {}
    for number, (name, pose) in enumerate(zip(NAMES, walk_poses(4), strict=True)):
        unit = pose.copy()
        unit[:3, 3] /= UNIT
        images[number] = SimpleNamespace(
            name=name,
            has_pose=True,
            camera=CAMERA,
            cam_from_world=lambda unit=unit: SimpleNamespace(matrix=lambda: unit[:3]),
        )
    return SimpleNamespace(images=images)


def in_photo(
    cam_from_world: NDArray[np.float64], point: NDArray[np.float64]
) -> tuple[float, float]:
    seen = CAMERA.img_from_cam((cam_from_world[:3, :3] @ point + cam_from_world[:3, 3])[None])
    assert seen is not None
    return float(seen[0, 0]), float(seen[0, 1])


def pixel(photo: str, point: NDArray[np.float64]) -> tuple[float, float]:
    """Where a photo shows a point, at its full size."""
    pose = walk_poses(4)[NAMES.index(photo)]
    x, y = in_photo(pose, point)
    factor = 1.0 if photo == NAMES[3] else 8.0
    return x * factor, y * factor


def lengths(noise: float = 0.0, photos: tuple[str, ...] = NAMES) -> KnownLengths:
    rng = np.random.default_rng(2)
    seen: dict[str, dict[str, tuple[float, float]]] = {}
    for name, point in POINTS.items():
        seen[name] = {}
        for photo in photos:
            sigma = noise if photo == NAMES[3] else 8.0 * noise
            x, y = np.array(pixel(photo, point)) + rng.normal(0, sigma, 2)
            seen[name][photo] = float(x), float(y)
    pairs = (("left", "right"), ("left", "top"))
    metres = {(a, b): float(np.linalg.norm(POINTS[a] - POINTS[b])) for a, b in pairs}
    return KnownLengths(seen, metres)


SIZES = {name: FULL for name in NAMES[:3]}


def test_lengths_tell_the_scale() -> None:
    assert scaled_by_points(model(), lengths(), SIZES).scale == pytest.approx(UNIT, rel=1e-6)
    found = scaled_by_points(model(), lengths(noise=1.0), SIZES)  # pixels of 500
    assert found.scale == pytest.approx(UNIT, rel=0.02)
    two = scaled_by_points(model(), lengths(photos=(NAMES[0], NAMES[3])), SIZES)
    assert two.scale == pytest.approx(UNIT, rel=1e-6)
    np.testing.assert_array_equal(two.rotation, np.eye(3))


def test_a_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "door.txt"
    path.write_text(
        "\ufeff# the door\n"
        "left, IMG 1.HEIC, 812, 1043.5\n"
        'left,"a, b.jpg", 90, 1040\n\n'
        "right, IMG 1.HEIC, 1500, 1040\nright, sub\\IMG 2.jpg, 800, 1041\n"
        "left, right, 0.86\n",
        encoding="utf-8",
    )
    source = ScaleSource.parse(f"points:{path}")
    assert source.kind == "points" and source.lengths is not None
    assert source.lengths.metres == {("left", "right"): 0.86}
    assert source.lengths.seen["left"] == {
        "IMG 1.HEIC": (812.0, 1043.5),
        "a, b.jpg": (90.0, 1040.0),
    }


GOOD = "a,1.jpg,1,2\na,2.jpg,1,2\nb,1.jpg,1,2\nb,2.jpg,1,2\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD, "no length"),
        (GOOD + "a,b\n", "line 5"),
        (GOOD + "a,b,0\n", "line 5"),
        (GOOD + "a,a,2\n", "line 5"),
        (GOOD + "a,b,2,m,5\n", "line 5"),
        (GOOD + "a,1.jpg,3,4\na,b,2\n", "line 5"),
        (GOOD + "a,3.jpg,nan,4\na,b,2\n", "line 5"),
        (GOOD + "a,c,2\n", "'c' is shown in 0 photos"),
        (GOOD + "c,1.jpg,1,1\na,c,2\n", "'c' is shown in 1 photos"),
    ],
)
def test_files_that_say_no_length(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "points.txt"
    path.write_text(text)
    with pytest.raises(SettingsError, match=message):
        read_lengths(path)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read"):
        ScaleSource.parse(f"points:{tmp_path / 'none.txt'}")
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff\xe0")
    with pytest.raises(SettingsError, match="cannot be read"):
        ScaleSource.parse(f"points:{tmp_path / 'photo.jpg'}")


def changed(name: str, photo: str, x: float, y: float) -> KnownLengths:
    good = lengths()
    seen = {point: dict(sights) for point, sights in good.seen.items()}
    seen[name][photo] = x, y
    return KnownLengths(seen, good.metres)


def test_points_that_do_not_tell() -> None:
    x, y = pixel(NAMES[0], POINTS["left"])
    for wrong in (changed("left", NAMES[0], x + 400, y - 400), changed("left", NAMES[0], x, 50)):
        with pytest.raises(ReconstructionError, match=r"one point 'left': .* does not fit"):
            scaled_by_points(model(), wrong, SIZES)
    with pytest.raises(ReconstructionError, match=r"outside of its 500x375 pixels"):
        scaled_by_points(model(), changed("left", NAMES[3], 501.0, 5.0), SIZES)
    with pytest.raises(ReconstructionError, match=r"other.jpg, .* was not placed"):
        scaled_by_points(model(), changed("left", "other.jpg", 5.0, 5.0), SIZES)
    contradiction = lengths()
    metres = {**contradiction.metres, ("right", "top"): 3.0}
    with pytest.raises(ReconstructionError, match=r"contradict each other.*'right' to 'top'"):
        scaled_by_points(model(), KnownLengths(contradiction.seen, metres), SIZES)


@pytest.mark.parametrize("step", [0.0, 0.001, 0.05])
def test_photos_of_one_spot_tell_no_length(step: float) -> None:
    """Two photos from (nearly) the same place: the points' distance is anything."""
    nearby, pose = model(), walk_poses(4)[0].copy()
    pose[0, 3] += step
    unit = pose.copy()
    unit[:3, 3] /= UNIT
    nearby.images[3].cam_from_world = lambda: SimpleNamespace(matrix=lambda: unit[:3])
    seen = {}
    for name, point in POINTS.items():
        seen[name] = {NAMES[0]: pixel(NAMES[0], point), NAMES[3]: in_photo(pose, point)}
    with pytest.raises(ReconstructionError, match="farther apart"):
        scaled_by_points(nearby, KnownLengths(seen, lengths().metres), SIZES)
