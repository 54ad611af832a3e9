# SPDX-License-Identifier: Apache-2.0
"""The page that grows while photos are localized or a camera is followed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_map
from viewing import detail, step

from gscpe.cli.main import main
from gscpe.geometry import se3
from gscpe.geometry.pose_error import camera_centre
from gscpe.photos import write_image
from gscpe.scene import save_map
from gscpe.viewer import Contents, Findings, Live, Viewer, contents_of


def shown(live: Live) -> Contents:
    """What the page shows, once everything is drawn."""
    live.finish()
    return live.viewer.contents


def test_what_more_is_found_changes_neither_sizes_nor_most_of_what_is_drawn() -> None:
    base = contents_of(room_map())
    for count, drawn in ((3, "012"), (5, "01234"), (6, "024"), (9, "02468"), (11, "048")):
        details = {f"{i}": detail(f"{i}", True, i) for i in range(count)}
        grown = contents_of(room_map(), Findings(details=details), most_cameras=5, like=base)
        assert [camera.name for camera in grown.of_kind("final")] == list(drawn)
        assert grown.frustum_depth == base.frustum_depth
        assert np.array_equal(grown.axes, base.axes)
    assert grown.notes == ("3 of 11 localized photos are drawn.",)


def test_results_arrive_in_the_contents() -> None:
    pytest.importorskip("viser")
    with Live(room_map(), most_gaussians=100) as live:
        live.add_detail(detail("a.png", True))
        live.add_detail(detail("b.png", False))
        for number in range(8):
            live.add(*step(number))
        contents = shown(live)
    assert [camera.name for camera in contents.of_kind("final")] == ["a.png"]
    assert [(each.name, each.reason) for each in contents.refused] == [
        ("b.png", "too few matches"),
        ("frame 3", "it is dark"),
        ("frame 7", "it is dark"),
    ]
    trajectory = contents.trajectory
    assert trajectory is not None
    np.testing.assert_allclose(trajectory.times, [0.0, 0.1, 0.2, 0.4, 0.5, 0.6])
    frame = room_map().frame
    for number, centre in zip((0, 1, 2, 4, 5, 6), trajectory.centres, strict=True):
        pose = step(number)[1].cam_from_world
        assert pose is not None
        np.testing.assert_allclose(centre, camera_centre(frame.cam_from_map(pose)), atol=1e-12)


def test_the_overview_grows_too() -> None:
    pytest.importorskip("viser")
    with Live(room_map(), most_gaussians=100) as live:
        before, begin = live.viewer._photos.afar, live.viewer._photos.begin
        for number in range(30):  # three metres to the side
            live.add(*step(number))
        live.finish()
        after = live.viewer._photos.afar
        assert live.viewer._photos.begin is begin
    assert before is not None
    assert after is not None
    assert np.linalg.norm(after.position - before.position) > 0.3


def test_an_early_end_is_quick_and_says_nothing() -> None:
    pytest.importorskip("viser")
    with Live(room_map(), most_gaussians=100) as live:
        live.add_detail(detail("a.png", True))
    live.add_detail(detail("b.png", True))  # nobody is there any more


@pytest.fixture
def page_read(monkeypatch: pytest.MonkeyPatch) -> list[Viewer]:
    """Pages that stayed until somebody pressed Ctrl-C, which happens at once here."""
    pages: list[Viewer] = []

    def wait(viewer: Viewer) -> None:
        pages.append(viewer)
        raise KeyboardInterrupt

    monkeypatch.setattr(Viewer, "wait", wait)
    return pages


def photos(folder: Path) -> str:
    """A map, two photos of it, a list; the map's path."""
    save_map(room_map(), folder / "room.gsmap")
    camera = room_camera(240, 180)
    for number in range(2):
        pose = se3.exp([0.03 * number, -0.03, 0.01, 0.02, -0.02, 0.03]) @ ROOM_POSE
        write_image(folder / "photos" / f"{number}.png", room().shoot(camera, pose).uint8)
    write_image(folder / "photos" / "2.png", np.full((180, 240, 3), 90, np.uint8))
    return str(folder / "room.gsmap")


def test_from_the_command_line(
    tmp_path: Path, page_read: list[Viewer], capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    map_ = photos(tmp_path)
    camera = ["--camera", room_camera(240, 180).colmap_text(), "--matcher", "sift"]
    page = ["--view", "--no-open", "--gaussians", "500"]
    folder = str(tmp_path / "photos")
    many = ["--images", folder, "--output", str(tmp_path / "poses.txt"), "--workers", "1"]
    assert main(["localize", map_, *many, *camera, *page]) == 0
    assert "stays until Ctrl-C" in capsys.readouterr().err
    assert [c.name for c in page_read[0].contents.of_kind("final")] == ["0.png", "1.png"]
    assert [each.name for each in page_read[0].contents.refused] == ["2.png"]
    assert main(["localize", map_, f"{folder}/1.png", *camera, *page]) == 0
    assert [c.name for c in page_read[1].contents.of_kind("final")] == [f"{folder}/1.png"]
    out = ["--output", str(tmp_path / "walk.tum"), "--rate", "10"]
    assert main(["track", map_, folder, *out, *camera, *page]) == 0
    walk = page_read[2].contents
    assert walk.trajectory is not None
    assert len(walk.trajectory.times) == 2
    assert [each.name for each in walk.refused] == ["2.png"]
    for wrong in (["--port", "99999", "--view"], ["--port", "8099"], ["--view", "--also", map_]):
        with pytest.raises(SystemExit):
            main(["localize", map_, f"{folder}/1.png", *camera, *wrong])
