# SPDX-License-Identifier: Apache-2.0
"""Damaged text files: a reader answers with a typed error, or reads what is still a data set."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable

import dataset_folders as folders
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gscpe.datasets import (
    Dataset,
    read_cambridge,
    read_fast_livo2,
    read_rgbd_folder,
    read_seven_scenes,
    read_transforms,
)
from gscpe.errors import DatasetError, InputError

Case = tuple[Callable[[Path], Any], Callable[[Path], Dataset], tuple[str, ...]]
CASES: dict[str, Case] = {
    "7-Scenes": (
        folders.write_seven_scenes,
        lambda root: read_seven_scenes(root, "redkitchen"),
        (
            "redkitchen/TrainSplit.txt",
            "redkitchen/seq-01/frame-000001.pose.txt",
            "pgt/sfm/7scenes/redkitchen_train.txt",
            "redkitchen/seq-01/frame-000000.color.png",
        ),
    ),
    "Cambridge": (
        folders.write_cambridge,
        lambda root: read_cambridge(root, "KingsCollege"),
        ("KingsCollege/dataset_test.txt", "KingsCollege/reconstruction.nvm"),
    ),
    "FAST-LIVO2": (
        folders.write_fast_livo2,
        lambda root: read_fast_livo2(root, "CBD_Building_01"),
        tuple(
            f"CBD_Building_01/{n}" for n in ("trajectory.txt", "camera_pinhole.yaml", "avia.yaml")
        ),
    ),
    "nerfstudio": (folders.write_transforms, read_transforms, ("transforms.json",)),
    "RGB-D": (
        lambda root: folders.write_rgbd_folder(root, form="stamps"),
        read_rgbd_folder,
        ("camera.txt", "trajectory.txt"),
    ),
}

SNIPPETS = st.one_of(
    st.sampled_from(
        [b"", b"\n", b" ", b"nan", b"-inf", b"1e999", b"1e200", b"0", b"-1", b"9" * 400]
    ),
    st.sampled_from([b"\x00", b"\xff\xfe", b"null", b"[", b"{}", b'"', b"!!matrix", b"../" * 2000]),
    st.binary(max_size=6),
)
# Where (a share of the file), how many bytes go, what comes instead.
CUTS = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.integers(0, 40), SNIPPETS), min_size=1, max_size=3
)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("case", CASES)
def test_only_typed_errors_come_out(case: str, tmp_path: Path) -> None:
    write, read, files = CASES[case]
    write(tmp_path)
    whole = {file: (tmp_path / file).read_bytes() for file in files}
    raised = 0

    @settings(max_examples=60)
    @given(st.sampled_from(files), CUTS)
    def damage(file: str, cuts: list[tuple[float, int, bytes]]) -> None:
        nonlocal raised
        content = whole[file]
        for where, length, snippet in cuts:
            at = int(where * len(content))
            content = content[:at] + snippet + content[at + length :]
        (tmp_path / file).write_bytes(content)
        try:
            dataset = read(tmp_path)
            for poses in dataset.truths.values():
                assert all(np.all(np.isfinite(pose)) for pose in poses.values())
        except InputError:
            raised += 1
        finally:
            (tmp_path / file).write_bytes(whole[file])

    damage()
    read(tmp_path)
    assert raised > 10, "most of the damage must have been noticed"


@pytest.mark.parametrize(
    ("case", "file", "line", "text", "message"),
    [
        ("7-Scenes", 0, 1, "seq-01", "expected 'sequence1', got 'seq-01'"),
        ("7-Scenes", 2, 2, "a.png 1 0 0 0 0 0 0", "qw qx qy qz tx ty tz f"),
        ("7-Scenes", 2, 2, "a.png 0 0 0 0 0 0 0 525", "length zero"),
        ("7-Scenes", 2, 2, "a.png 1 0 0 0 0 0 0 -525", "focal lengths must be positive"),
        ("Cambridge", 0, 5, "seq2/a.png 1 2 3 1 0 0", "name X Y Z W P Q R"),
        ("Cambridge", 0, 5, "seq2/a.png 1 2 3 0 0 0 0", "length zero"),
        ("Cambridge", 1, 4, "seq1/a.jpg 55 1 0 0 0 1 2 3", "file focal qw"),
        ("FAST-LIVO2", 0, 3, "1669290000.5 1 2 3", "stamp tx ty tz qx qy qz qw"),
        ("RGB-D", 1, 1, "0.5 1 2 3 0 0 0 zero", "stamp tx ty tz qx qy qz qw"),
    ],
)
def test_a_bad_line_is_named(
    case: str, file: int, line: int, text: str, message: str, tmp_path: Path
) -> None:
    write, read, files = CASES[case]
    write(tmp_path)
    path = tmp_path / files[file]
    lines = path.read_text().splitlines()
    lines[line - 1] = text
    folders.write_lines(path, lines)
    with pytest.raises(DatasetError) as caught:
        read(tmp_path)
    assert f"{path}, line {line}: " in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize("radial", ["-9", "1e9", "nan"])
def test_impossible_distortion_is_refused(radial: str, tmp_path: Path) -> None:
    write, read, files = CASES["Cambridge"]
    write(tmp_path)
    path = tmp_path / files[1]
    path.write_text(path.read_text().replace(f"{folders.NVM_RADIAL} 0 ", f"{radial} 0 "))
    with pytest.raises(DatasetError, match=r"reconstruction\.nvm, seq1/frame00001\.png: "):
        read(tmp_path)


@pytest.mark.parametrize("kept", [2, 40])
def test_a_cut_off_nvm_is_noticed(kept: int, tmp_path: Path) -> None:
    write, read, files = CASES["Cambridge"]
    write(tmp_path)
    path = tmp_path / files[1]
    path.write_text("\n".join(path.read_text().splitlines()[:6][:kept]) + "\n")
    with pytest.raises(DatasetError, match=r"reconstruction\.nvm"):
        read(tmp_path)
