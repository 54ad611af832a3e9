"""Query lists in hloc's form: cameras read exactly; bad lines named by file and number."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gscpe.errors import QueryListError
from gscpe.geometry import Camera
from gscpe.scene.query_list import Query, read_query_list

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
        f"my photo.png {GOOD}",
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
