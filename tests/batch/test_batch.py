# SPDX-License-Identifier: Apache-2.0
"""Lists of photos: one bad photo harms no other, and what is finished is never lost."""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray

from gscpe import LocalizationResult, Localizer, PosePrior
from gscpe.batch import check_outputs, localize_list, read_details, write_poses
from gscpe.coarse import CoarseResult
from gscpe.errors import OutputError, RenderError
from gscpe.geometry import Camera, se3
from gscpe.localization import Attempt, Start
from gscpe.photos import to_photo, write_image
from gscpe.poses.hloc import format_pose, read_poses
from gscpe.refinement import RefinementResult
from gscpe.scene.query_list import Query

CAMERA = Camera.pinhole(16, 12, fx=14, fy=14, cx=8, cy=6)


def pose_of(number: int) -> NDArray[np.float64]:
    return random_pose(np.random.default_rng(number))


class Stub:
    """Reads the answer out of the photo: the value of its pixels is the seed of the pose.

    Photos of value 0 are not localized.
    """

    def __init__(self, interrupt_at: int | None = None) -> None:
        self.seen: list[int] = []
        self.interrupt_at = interrupt_at

    def localize(
        self, image: NDArray[np.uint8], camera: Camera, prior: PosePrior | None = None
    ) -> LocalizationResult:
        photo = to_photo(image, camera)
        number = int(photo.rgb[0, 0, 0])
        if self.interrupt_at is not None and len(self.seen) == self.interrupt_at:
            raise KeyboardInterrupt
        self.seen.append(number)
        seconds = {"retrieval": 0.1, "coarse": 0.2, "total": 0.31234567}
        if number == 0:
            return LocalizationResult(False, "too dark", None, None, camera, None, (), seconds)
        coarse_pose = se3.exp([0.01, 0, 0, 0, 0, 0]) @ pose_of(number)
        coarse = CoarseResult(
            coarse_pose, 50, 40, np.zeros((40, 2)), np.zeros((0, 2)), 0.5, 1e-6 * np.eye(6), 2, True
        )
        nan = float("nan")
        aligned = RefinementResult(
            pose_of(number), np.eye(6), 1.0, 0.0, nan, 0.9, 0.8, 1000, 2, 1.0, True
        )
        attempt = Attempt(Start("reference", coarse_pose, "ref.png"), coarse, aligned, None)
        return LocalizationResult(
            True, None, pose_of(number), np.eye(6), camera, attempt, (attempt,), seconds
        )


def run(stub: Stub, folder: Path, **options: Any) -> list[dict[str, Any]]:
    """Localizes all queries of the folder."""
    queries = [Query(f"photos/{n}.png", CAMERA) for n in "abcde"]
    localizer = cast(Localizer, stub)
    return localize_list(localizer, queries, folder, folder / "out" / "d.jsonl", **options)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Photos a to e, of the values 1 to 5."""
    for value, name in enumerate("abcde", start=1):
        write_image(tmp_path / "photos" / f"{name}.png", np.full((12, 16, 3), value, np.uint8))
    return tmp_path


def lines_of(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "out" / "d.jsonl").read_text().splitlines()]


def test_all_are_localized_in_order(folder: Path) -> None:
    details = run(Stub(), folder)
    assert [detail["name"] for detail in details] == [f"photos/{n}.png" for n in "abcde"]
    assert {detail["status"] for detail in details} == {"localized"}
    assert lines_of(folder) == details


def test_what_is_written(folder: Path) -> None:
    """Plain JSON without NaN, which other readers refuse."""
    detail = run(Stub(), folder)[0]
    assert detail["reason"] is None
    assert detail["reference"] == "ref.png"
    assert detail["coarse"]["inliers"] == 40
    assert detail["aligned"]["residual"] is None  # it was NaN
    assert detail["aligned"]["agreement"] == 0.9
    assert np.array(detail["covariance"]).shape == (6, 6)
    assert detail["seconds"] == {"retrieval": 0.1, "coarse": 0.2, "total": 0.3123}
    assert "NaN" not in (folder / "out" / "d.jsonl").read_text()


def test_bad_photos_fail_alone(folder: Path) -> None:
    (folder / "photos" / "b.png").write_bytes(b"\x89PNG\r\n\x1a\nbut no more")
    (folder / "photos" / "c.png").unlink()
    write_image(folder / "photos" / "d.png", np.full((9, 9, 3), 4, np.uint8))
    write_image(folder / "photos" / "e.png", np.zeros((12, 16, 3), np.uint8))
    a, b, c, d, e = run(Stub(), folder)
    assert a["status"] == "localized"
    assert {x["status"] for x in (b, c, d)} == {"failed"}
    assert e["status"] == "not localized"
    assert "b.png is not an image" in b["reason"]
    assert "c.png cannot be read: No such file" in c["reason"]
    assert "is 9x9, but its camera is 16x12" in d["reason"]
    assert e["reason"] == "too dark"
    for bad in (b, c, d, e):
        assert bad["cam_from_world"] is None
    assert set(b) == set(a)  # the same fields, whatever happened
    assert len(lines_of(folder)) == 5


def test_an_interruption_keeps_what_is_finished(folder: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(Stub(interrupt_at=2), folder)
    assert [line["name"] for line in lines_of(folder)] == ["photos/a.png", "photos/b.png"]


def test_each_line_is_on_disk_before_the_next_photo(folder: Path) -> None:
    """So that even a power cut costs one photo."""
    lengths: list[int] = []

    class Watching(Stub):
        def localize(
            self, image: NDArray[np.uint8], camera: Camera, prior: PosePrior | None = None
        ) -> LocalizationResult:
            lengths.append(len(lines_of(folder)))
            return super().localize(image, camera, prior)

    run(Watching(), folder)
    assert lengths == [0, 1, 2, 3, 4]


def test_resuming_goes_on_from_there(folder: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(Stub(interrupt_at=2), folder)
    stub = Stub()
    details = run(stub, folder, resume=True)
    assert stub.seen == [3, 4, 5]
    assert [detail["name"] for detail in details] == [f"photos/{n}.png" for n in "abcde"]
    assert details == run(Stub(), folder)  # as if it had never been interrupted
    assert run(Stub(interrupt_at=0), folder, resume=True) == details  # nothing is left to do


def test_a_photo_that_changed_is_done_again(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Under the same name, of the same size, and of the same time."""
    run(Stub(), folder)
    changed = folder / "photos" / "c.png"
    time = changed.stat().st_mtime_ns
    write_image(changed, np.full((12, 16, 3), 9, np.uint8))
    os.utime(changed, ns=(time, time))
    stub = Stub()
    with caplog.at_level(logging.WARNING):
        details = run(stub, folder, resume=True)
    assert stub.seen == [9]
    assert details[2]["cam_from_world"] == format_pose(pose_of(9))
    (record,) = caplog.records
    assert record.getMessage().startswith("localizing 1 photos again: their files have changed")
    assert run(Stub(interrupt_at=0), folder, resume=True) == details  # that is noted, too


def test_a_photo_that_memory_is_short_for_fails_alone(folder: Path) -> None:
    class Small(Stub):
        def localize(
            self, image: NDArray[np.uint8], camera: Camera, prior: PosePrior | None = None
        ) -> LocalizationResult:
            if image[0, 0, 0] == 2:
                raise MemoryError("Unable to allocate 3 GiB")
            if image[0, 0, 0] == 3:
                raise RenderError("no memory to render") from MemoryError()
            return super().localize(image, camera, prior)

    details = run(Small(), folder)
    statuses = [detail["status"] for detail in details]
    assert statuses == ["localized", "failed", "failed", "localized", "localized"]
    assert "not enough memory" in details[1]["reason"]
    assert "b.png" in details[1]["reason"]


def test_a_name_that_is_no_text_is_written_as_it_is(tmp_path: Path) -> None:
    """After all work, nothing may fail for a name."""
    detail = {"name": "\udcff.png", "status": "localized", "cam_from_world": "1 0 0 0 0 0 0"}
    write_poses([detail], tmp_path / "poses.txt", "final")
    assert (tmp_path / "poses.txt").read_bytes() == b"\xff.png 1 0 0 0 0 0 0\n"


def test_outputs_may_be_links(folder: Path) -> None:
    """They stay links, also before there is what they lead to."""
    link, target = folder / "d.jsonl", folder / "elsewhere.jsonl"
    link.symlink_to(target)
    check_outputs([link])
    assert link.is_symlink()
    assert not target.exists()
    queries = [Query("photos/a.png", CAMERA)]
    for _ in range(2):
        localize_list(cast(Localizer, Stub()), queries, folder, link)
        assert link.is_symlink()
    assert list(read_details(target)) == ["photos/a.png"]
    assert list(read_details(folder / "elsewhere.jsonl.bak")) == ["photos/a.png"]


def test_a_line_that_was_cut_off_is_done_again(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run(Stub(), folder)
    path = folder / "out" / "d.jsonl"
    whole = path.read_bytes()
    third = whole.index(b"\n", whole.index(b"\n") + 1) + 1
    path.write_bytes(whole[: third + 40])
    stub = Stub()
    with caplog.at_level(logging.WARNING):
        run(stub, folder, resume=True)
    assert stub.seen == [3, 4, 5]
    assert "1 of 3 lines are cut off" in caplog.text
    assert path.read_bytes() == whole


def test_a_photo_that_left_the_list_leaves_the_details(folder: Path) -> None:
    run(Stub(), folder)
    queries = [Query("photos/b.png", CAMERA)]
    details = localize_list(
        cast(Localizer, Stub(0)), queries, folder, folder / "out" / "d.jsonl", resume=True
    )
    assert [detail["name"] for detail in details] == ["photos/b.png"]
    assert len(lines_of(folder)) == 1


def test_without_resume_it_begins_anew_and_keeps_a_copy(folder: Path) -> None:
    run(Stub(), folder)
    before = (folder / "out" / "d.jsonl").read_bytes()
    stub = Stub()
    run(stub, folder)
    assert stub.seen == [1, 2, 3, 4, 5]
    assert (folder / "out" / "d.jsonl.bak").read_bytes() == before
    names = sorted(path.name for path in (folder / "out").iterdir())
    assert names == ["d.jsonl", "d.jsonl.bak"]


def test_pose_files_hold_the_localized(folder: Path) -> None:
    write_image(folder / "photos" / "c.png", np.zeros((12, 16, 3), np.uint8))
    details = run(Stub(), folder)
    write_poses(details, folder / "aligned.txt", "aligned")
    write_poses(details, folder / "coarse.txt", "coarse")
    aligned, coarse = read_poses(folder / "aligned.txt"), read_poses(folder / "coarse.txt")
    assert list(aligned) == list(coarse) == [f"photos/{n}.png" for n in "abde"]
    np.testing.assert_allclose(aligned["photos/d.png"], pose_of(4), atol=1e-8)
    expected = se3.exp([0.01, 0, 0, 0, 0, 0]) @ pose_of(4)
    np.testing.assert_allclose(coarse["photos/d.png"], expected, atol=1e-8)


def test_details_that_cannot_be_read_or_written(folder: Path) -> None:
    assert read_details(folder / "absent.jsonl") == {}
    (folder / "binary").write_bytes(b"\xff\xfe\x00\x80")
    for path in (folder / "binary", folder):
        with pytest.raises(OutputError, match="is not a details file"):
            read_details(path)
    below = folder / "binary" / "d.jsonl"
    with pytest.raises(OutputError, match="cannot be written"):
        localize_list(cast(Localizer, Stub()), [], folder, below)


def test_outputs_are_checked_before_the_work(folder: Path) -> None:
    check_outputs([folder / "new" / "a.txt", None, folder / "b.txt"])
    assert (folder / "new").is_dir()
    assert not (folder / "new" / "a.txt").exists()  # nothing empty is left behind
    (folder / "b.txt").write_text("kept")
    check_outputs([folder / "b.txt"])
    assert (folder / "b.txt").read_text() == "kept"
    for path in (folder, folder / "b.txt" / "c.txt"):
        with pytest.raises(OutputError, match="cannot be written"):
            check_outputs([path])
