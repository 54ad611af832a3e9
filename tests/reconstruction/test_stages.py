# SPDX-License-Identifier: Apache-2.0
"""Parts of putting photos together that need no photos, or few."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes import room_shot

from gscpe.errors import OutputError, ReconstructionError
from gscpe.reconstruction import not_kept_if_refused, open_work_folder, sharpness
from gscpe.reconstruction.pairs import chosen_once, in_order, look_alike
from gscpe.reconstruction.photos import PreparedPhoto
from gscpe.reconstruction.sources import find_source


def photo(name: str, video: str = "") -> PreparedPhoto:
    return PreparedPhoto(name, "camera", 64, 48, None, 0.3, video)


def test_order_stays_within_a_video() -> None:
    photos = [photo(f"a/{i}", "a") for i in range(12)] + [photo(f"b/{i}", "b") for i in range(3)]
    pairs = in_order(photos, 2)
    assert {(0, 1), (0, 2), (0, 4), (0, 8), (12, 13), (12, 14)} <= set(pairs)
    assert not any(first < 12 <= second for first, second in pairs)
    assert (0, 3) not in pairs
    assert (0, 4) not in in_order([photo(str(i)) for i in range(12)], 2), (
        "photos have no long steps"
    )


def test_each_is_paired_with_those_most_like_it() -> None:
    angles = np.radians([0, 5, 90, 95, 180])
    descriptors = np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)
    assert look_alike(descriptors, 1) == [(0, 1), (2, 3), (3, 4)]
    assert len(look_alike(descriptors, 10)) == 10


def test_pairs_are_chosen_once(tmp_path: Path) -> None:
    path = tmp_path / "pairs.json"
    asked = []

    def choose() -> list[tuple[str, str]]:
        asked.append(1)
        return [("a b.jpg", "c.jpg")]

    for _ in range(2):
        assert chosen_once(path, choose) == [("a b.jpg", "c.jpg")]
    assert len(asked) == 1


@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_sharpness_follows_the_blur_and_not_the_noise(noise: float) -> None:
    rng = np.random.default_rng(0)
    step = np.zeros((200, 300), dtype=np.float32)
    step[:, 150:] = 120
    for blur in (0.5, 1.0, 2.0, 4.0):
        blurred = cv2.GaussianBlur(step, (0, 0), blur) + 50 + rng.normal(0, noise, step.shape)
        expected = (np.sqrt((blur**2 + 9.5) / (blur**2 + 1.5)) - 1) / 2
        grey = np.clip(np.rint(blurred), 0, 255).astype(np.uint8)
        assert sharpness(grey) == pytest.approx(expected, rel=0.06, abs=0.01)
    assert sharpness(np.full((50, 60, 3), 80, dtype=np.uint8)) == 0.0
    darker = (0.4 * room_shot().uint8).astype(np.uint8)
    assert sharpness(darker) == pytest.approx(sharpness(room_shot().uint8), rel=0.05)


def test_a_work_folder_is_gone_on_with_or_not_touched(tmp_path: Path) -> None:
    folder = tmp_path / "work"
    open_work_folder(folder, {"photos": [1, 2]}, resume=False, finished="end")
    (folder / "half.txt").write_text("half")
    with pytest.raises(OutputError, match="--resume"):
        open_work_folder(folder, {"photos": [1, 2]}, resume=False, finished="end")
    with pytest.raises(OutputError, match="other photos"):
        open_work_folder(folder, {"photos": [1]}, resume=True, finished="end")
    open_work_folder(folder, {"photos": [1, 2]}, resume=True, finished="end")
    assert (folder / "half.txt").exists()
    (folder / "end").touch()
    open_work_folder(folder, {"photos": [1]}, resume=False, finished="end")
    assert not (folder / "half.txt").exists(), "what is finished is begun anew"
    other = tmp_path / "mine"
    other.mkdir()
    (other / "thesis.txt").write_text("years of work")
    with pytest.raises(OutputError, match="not of gscpe"):
        open_work_folder(other, {}, resume=False, finished="end")
    assert (other / "thesis.txt").exists()


def test_names_of_sources(tmp_path: Path) -> None:
    live_photo = ("b/1.jpg", "b/1.mov")
    hidden = ("a/._1.JPG", "a/.thumbs/3.jpg")
    for name in ("a/1.JPG", "a/sub/2.heic", "b/v.mov", *live_photo, *hidden):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    assert list(find_source([tmp_path / "a"]).photos) == ["1.JPG", "sub/2.heic"]
    both = find_source([tmp_path / "a", tmp_path / "b"])
    assert list(both.photos) == ["a/1.JPG", "a/sub/2.heic", "b/1.jpg"]
    assert list(both.videos) == ["b/v"]


def test_what_is_refused_at_once_leaves_no_folder(tmp_path: Path) -> None:
    """But what a run could go on with stays, and so does what other errors leave."""
    for made, error, stays in (
        ("images/a.jpg", ReconstructionError("too few"), False),
        ("photos.json", ReconstructionError("a wrong name"), True),
        ("images/a.jpg", OutputError("the disk is full"), True),
    ):
        folder = tmp_path / "work"
        open_work_folder(folder, {}, resume=False, finished="end")
        with pytest.raises(type(error)), not_kept_if_refused(folder):
            (folder / made).parent.mkdir(exist_ok=True)
            (folder / made).touch()
            raise error
        assert folder.exists() == stays
        shutil.rmtree(folder, ignore_errors=True)
