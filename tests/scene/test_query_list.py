# SPDX-License-Identifier: Apache-2.0
"""Query lists in hloc's form: cameras read exactly; bad lines named by file and number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gscpe.errors import QueryListError
from gscpe.geometry import Camera
from gscpe.photos import write_image
from gscpe.scene.query_list import Query, fit_queries, folder_queries, read_query_list

GOOD = "PINHOLE 640 480 525.505 525.505 320 240"

names = st.text(st.characters(codec="utf-8", categories=["L", "N"]), min_size=1, max_size=12)
cameras = st.builds(
    Camera,
    st.integers(1, 9999),
    st.integers(1, 9999),
    st.floats(1e-3, 1e5),
    st.floats(1e-3, 1e5),
    st.floats(-1e5, 1e5),
    st.floats(-1e5, 1e5),
    st.sampled_from([(), (0.1, -0.05, 0.002, -0.003, 0.01, 0.0, 0.0, 0.0)]),
)


@given(st.dictionaries(names, cameras, min_size=1, max_size=5))
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, queries: dict[str, Camera]) -> None:
    path = tmp_path_factory.mktemp("lists") / "queries.txt"
    lines = [f"{name}.jpg {camera.colmap_text()}\n" for name, camera in queries.items()]
    path.write_text("".join(lines), encoding="utf-8")
    expected = tuple(Query(f"{name}.jpg", camera) for name, camera in queries.items())
    assert read_query_list(path) == expected
    assert read_query_list(str(path)) == expected


def test_models_comments_and_blanks(tmp_path: Path) -> None:
    path = tmp_path / "queries.txt"
    path.write_text(
        f"# name MODEL width height params\r\n\na.png {GOOD}\r\n"
        "  seq/b.png SIMPLE_RADIAL 800 600 700.5 400 300 -0.01\n"
        "c.png OPENCV 64 48 50 51 32 24 0.1 0.2 0.003 0.004"
    )
    a, b, c = read_query_list(path)
    assert a == Query("a.png", Camera.pinhole(640, 480, fx=525.505, fy=525.505, cx=320, cy=240))
    assert (b.name, b.camera.fx, b.camera.distortion[0]) == ("seq/b.png", 700.5, -0.01)
    assert c.camera.distortion == (0.1, 0.2, 0.003, 0.004, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "line",
    [
        "b.png",
        "b.png PINHOLE",
        "b.png PINHOLE 640 480",
        "b.png PINHOLE 640 480 525 525 320",
        "b.png PINHOLE 640 480 525 525 320 240 0",
        "b.png FOV 640 480 525 525 320 240 1",
        "b.png PINHOLE 640.5 480 525 525 320 240",
        "b.png PINHOLE wide 480 525 525 320 240",
        "b.png PINHOLE 640 480 -525 525 320 240",
        "b.png PINHOLE 640 480 nan 525 320 240",
        "b.png PINHOLE 0 480 525 525 320 240",
        f"a.png {GOOD}",
        "my photo.png PINHOLE wide 480 525 525 320 240",
        GOOD,
    ],
)
def test_bad_lines_are_named(line: str, tmp_path: Path) -> None:
    path = tmp_path / "queries.txt"
    path.write_text(f"# queries\na.png {GOOD}\n\n{line}\n")
    with pytest.raises(QueryListError) as caught:
        read_query_list(path)
    assert f"{path}, line 4: " in str(caught.value)


def test_tabs_separate_too(tmp_path: Path) -> None:
    path = tmp_path / "queries.txt"
    path.write_text("a.png\t" + GOOD.replace(" ", "\t") + "\n")
    assert read_query_list(path)[0].name == "a.png"


WANTED = Camera.pinhole(640, 480, fx=525.505, fy=525.505, cx=320, cy=240)


@pytest.mark.parametrize(
    ("line", "name"),
    [
        (f"my photo.png {GOOD}", "my photo.png"),
        (f"my  old PINHOLE 7.png {GOOD}", "my  old PINHOLE 7.png"),
        (f'"my photo.png" {GOOD}', "my photo.png"),
        (f'"the ""best"" photo", {GOOD}', 'the "best" photo'),
        (f"photo 1 {GOOD}", "photo 1"),
        (f"a.png {GOOD},", "a.png"),
        (f"a.png,{GOOD.replace(' ', ',')},,", "a.png"),
        (f"a.png, {GOOD.replace(' ', ', ')}", "a.png"),
        (f"a,b.png {GOOD}", "a,b.png"),
        ("a.png PINHOLE 640.0 480.0 525.505 525.505 320 240", "a.png"),
        (f"a.png {GOOD.replace('PIN', 'pin')}", "a.png"),
        (rf"seq\my photo.png {GOOD}", "seq/my photo.png"),
    ],
)
def test_lists_as_they_come(line: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / "queries.txt"
    path.write_text(f"{line}\nlast.png {GOOD}\n")
    assert read_query_list(path) == (Query(name, WANTED), Query("last.png", WANTED))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be"])
def test_other_encodings(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "queries.txt"
    mark = "\ufeff" if encoding.endswith("be") else ""
    path.write_bytes(f"{mark}büro.png {GOOD}\r\n".encode(encoding))
    assert read_query_list(path) == (Query("büro.png", WANTED),)


def test_names_alone(tmp_path: Path) -> None:
    """With one camera for all, which a line's own one comes before."""
    path = tmp_path / "names.txt"
    path.write_text('a.png\nmy photo.png,\n\n"b c.png"\nd.png PINHOLE 64 48 50 50 32 24\n')
    *alone, own = read_query_list(path, WANTED)
    assert alone == [Query(name, WANTED) for name in ("a.png", "my photo.png", "b c.png")]
    assert (own.name, own.camera.width) == ("d.png", 64)
    with pytest.raises(QueryListError, match=r"line 1: .*names alone need one camera.*--camera"):
        read_query_list(path)


def test_backslashes_of_a_photo_that_has_them(tmp_path: Path) -> None:
    path = tmp_path / "names.txt"
    path.write_text("a\\b.png\nc\\d.png\n")
    try:
        (tmp_path / "a\\b.png").touch()
    except OSError:
        pytest.skip("this system cannot")
    names = [query.name for query in read_query_list(path, WANTED, tmp_path)]
    assert names == ["a\\b.png" if (tmp_path / "a\\b.png").is_file() else "a/b.png", "c/d.png"]


def test_a_folder_of_photos(tmp_path: Path) -> None:
    for name in ("b.png", "sub/my photo.JPG", "a.jpeg", "notes.txt", "sub/depth.npy"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    names = ["a.jpeg", "b.png", "sub/my photo.JPG"]
    assert folder_queries(tmp_path, WANTED) == tuple(Query(name, WANTED) for name in names)
    (tmp_path / "empty").mkdir()
    with pytest.raises(QueryListError, match="empty holds no photos"):
        folder_queries(tmp_path / "empty", WANTED)


def test_photos_of_half_the_size(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Cameras are scaled where all photos agree; a photo that cannot be read has no say."""
    for name in ("a.png", "b.png"):
        write_image(tmp_path / name, np.zeros((240, 320, 3), np.uint8))
    queries = [Query(name, WANTED) for name in ("a.png", "absent.png", "b.png")]
    half = Camera.pinhole(320, 240, fx=262.7525, fy=262.7525, cx=160, cy=120)
    assert fit_queries(queries, tmp_path) == (
        Query("a.png", half),
        Query("absent.png", WANTED),
        Query("b.png", half),
    )
    (warning,) = caplog.messages
    assert "0.5 times as large" in warning
    assert "a.png, is 320x240, not 640x480" in warning
    caplog.clear()
    for shape in ((480, 640, 3), (120, 160, 3), (320, 240, 3), (240, 319, 3)):
        write_image(tmp_path / "b.png", np.zeros(shape, np.uint8))
        fitted = fit_queries(queries, tmp_path)
        if shape == (240, 319, 3):  # a pixel of rounding
            assert fitted[2].camera == queries[2].camera.resized(319, 240)
        else:
            assert fitted == tuple(queries)


@pytest.mark.parametrize("content", ["", "\n\n", "# only a comment\n"])
def test_empty_lists(content: str, tmp_path: Path) -> None:
    path = tmp_path / "queries.txt"
    path.write_text(content)
    with pytest.raises(QueryListError, match="is empty"):
        read_query_list(path)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(QueryListError, match=r"absent\.txt cannot be read"):
        read_query_list(tmp_path / "absent.txt")
    with pytest.raises(QueryListError, match="cannot be read"):
        read_query_list(tmp_path)
    (tmp_path / "queries.txt").write_bytes(b"\x80\x81\xff\xfe")
    with pytest.raises(QueryListError, match="is not a text file"):
        read_query_list(tmp_path / "queries.txt")
