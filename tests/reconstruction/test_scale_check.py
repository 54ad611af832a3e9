# SPDX-License-Identifier: Apache-2.0
"""A scale that cannot be of these photos is refused before anything long is done."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from walks import write_walk

from gscpe.errors import OutputError, PoseError, ReconstructionError
from gscpe.poses import write_pose_file
from gscpe.reconstruction import KnownLengths, ScaleSource, reconstruct
from gscpe.reconstruction.photos import PreparedPhoto
from gscpe.reconstruction.scale_check import check_scale_source

NAMES = ("a.jpg", "b.heic.jpg", "c/d.jpg", "e.jpg")
UNUSABLE = {"copy.jpg": "is a copy of a.jpg"}


def photos(gps: int = 0) -> list[PreparedPhoto]:
    return [
        PreparedPhoto(
            name, "", 40, 30, None, 1.0, gps=(1, 2, 3) if i < gps else None, full_size=(400, 300)
        )
        for i, name in enumerate(NAMES)
    ]


def check(source: ScaleSource, gps: int = 0) -> None:
    check_scale_source(source, photos(gps), UNUSABLE)


def points(photo: str, x: float = 5.0, y: float = 5.0) -> ScaleSource:
    """The lengths of a file in which the left point is seen there."""
    left = {"a.jpg": (1.0, 1.0), photo: (x, y)}
    right = {"a.jpg": (2.0, 2.0), "e.jpg": (5.0, 6.0)}
    lengths = KnownLengths({"left": left, "right": right}, {("left", "right"): 1.0})
    return ScaleSource("points", lengths=lengths)


def test_what_may_be_of_these_photos(tmp_path: Path) -> None:
    check(ScaleSource())
    check(ScaleSource("gps"), gps=3)
    check(ScaleSource("distance", between=("a.jpg", "b.heic"), metres=1.0))
    check(points("c\\d.jpg", 399.5, 299.5))
    write_pose_file(tmp_path / "poses.txt", dict.fromkeys(NAMES[:3], np.eye(4)), "hloc")
    check(ScaleSource("poses", poses=tmp_path / "poses.txt"))
    cv2.imwrite(str(tmp_path / "e.png"), np.ones((15, 20), dtype=np.uint16))
    check(ScaleSource("depth", depth=tmp_path))


def test_what_cannot_be_of_these_photos(tmp_path: Path) -> None:
    with pytest.raises(ReconstructionError, match=r"2 of the 4 photos .* GPS position"):
        check(ScaleSource("gps"), gps=2)
    with pytest.raises(ReconstructionError, match=r"f\.jpg.* is not among the photos; .*a\.jpg"):
        check(ScaleSource("distance", between=("a.jpg", "f.jpg"), metres=1.0))
    with pytest.raises(ReconstructionError, match=r"copy\.jpg.*cannot be used .is a copy of"):
        check(points("copy.jpg"))
    with pytest.raises(ReconstructionError, match="outside of its 400x300 pixels"):
        check(points("c/d.jpg", 400.5, 10.0))
    write_pose_file(tmp_path / "poses.txt", dict.fromkeys(("x", "a.jpg"), np.eye(4)), "hloc")
    with pytest.raises(ReconstructionError, match="1 of the 4 photos"):
        check(ScaleSource("poses", poses=tmp_path / "poses.txt"))
    (tmp_path / "poses.txt").write_text("nothing of the kind\n")
    with pytest.raises(PoseError, match=r"poses\.txt"):
        check(ScaleSource("poses", poses=tmp_path / "poses.txt"))
    with pytest.raises(ReconstructionError, match=r"no depth image of the photos"):
        check(ScaleSource("depth", depth=tmp_path))
    cv2.imwrite(str(tmp_path / "e.png"), np.ones((15, 20), dtype=np.uint8))
    with pytest.raises(ReconstructionError, match="not a depth image"):
        check(ScaleSource("depth", depth=tmp_path))


def test_it_is_refused_before_structure_from_motion(tmp_path: Path) -> None:
    write_walk(tmp_path / "photos", 3)
    scale = ScaleSource.parse("distance:IMG_0000.jpg,typo.jpg,2")
    with pytest.raises(ReconstructionError, match=r"typo\.jpg"):
        reconstruct(tmp_path / "photos", tmp_path / "model", scale=scale)
    assert not (tmp_path / "model" / "database.db").exists()
    # What a crash left half written is said to be damaged.
    (tmp_path / "model" / "photos.json").write_text('{"photos": [')
    with pytest.raises(OutputError, match=r"photos\.json is damaged .*delete"):
        reconstruct(tmp_path / "photos", tmp_path / "model", resume=True)
