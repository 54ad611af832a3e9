# SPDX-License-Identifier: Apache-2.0
"""The tables of a benchmark: their numbers, and four ways to write them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Mapping

import numpy as np
import pytest
from helpers import random_pose
from numpy.typing import NDArray

from gscpe.errors import DatasetError, OutputError
from gscpe.evaluation import SceneRun, published
from gscpe.evaluation.ablation_table import AblationRow, ablation_table
from gscpe.evaluation.accuracy_tables import accuracy_table, shares_table
from gscpe.evaluation.query_table import query_table
from gscpe.evaluation.runtime_table import runtime_table, stage_times_table
from gscpe.evaluation.table import Table, to_json, to_latex, to_markdown, to_text
from gscpe.evaluation.tables import benchmark_tables, write_tables
from gscpe.evaluation.text import NOTHING, significant_text
from gscpe.geometry import se3
from gscpe.poses.hloc import format_pose

Poses = dict[str, NDArray[np.float64]]


def moved(pose: NDArray[np.float64], metres: float, degrees: float) -> NDArray[np.float64]:
    """A pose whose camera centre and rotation differ by exactly this much."""
    turned = se3.exp([0, 0, 0, 0, np.radians(degrees), 0]) @ pose
    centre = se3.inverse(pose)[:3, 3] + [metres, 0, 0]
    turned[:3, 3] = -turned[:3, :3] @ centre
    return np.asarray(turned)


def scene_run(
    scene: str,
    errors: list[tuple[float, float] | None],
    *,
    coarse: bool = True,
    unit: float | None = 1.0,
    setup: Mapping[str, str] | None = None,
    seconds: float = 0.1,
) -> SceneRun:
    """Queries that end as far off (centimetres and degrees) as ``errors`` says, None: not
    localized; coarse poses are twice, aligned ones 1.5 times as far off. A second truth is 1 cm
    aside."""
    rng = np.random.default_rng(len(scene))
    truth = {f"{i}.png": random_pose(rng) for i in range(len(errors))}
    aside = {name: moved(pose, 0.01, 0.0) for name, pose in truth.items()}
    details: list[dict[str, Any]] = []
    for (name, pose), error in zip(truth.items(), errors, strict=True):
        detail: dict[str, Any] = {"name": name, "coarse": None, "aligned": None}
        if error is None:
            detail |= {"status": "not localized", "cam_from_world": None}
            detail["seconds"] = {"features": seconds, "total": seconds}
        else:
            scale = 0.01 / (unit or 1.0)
            poses = [
                {"cam_from_world": format_pose(moved(pose, k * scale * error[0], k * error[1]))}
                for k in (1, 2, 1.5)
            ]
            detail |= {"status": "localized", **poses[0], "aligned": poses[2]}
            detail["coarse"] = poses[1] if coarse else None
            detail["seconds"] = {
                **{"features": seconds, "retrieval": 2 * seconds, "coarse": 3 * seconds},
                **{"refinement": 4 * seconds, "total": 10 * seconds * (1 + error[0])},
            }
        details.append(detail)
    return SceneRun(
        dataset="7-Scenes",
        scene=scene,
        details=tuple(details),
        truths={"sfm": truth, "dslam": aside},
        metres_per_unit=unit,
        setup={"split": "official", "cores": "2"} if setup is None else setup,
    )


CHESS = scene_run("chess", [(0.4, 0.1), (0.8, 0.3), (1.2, 0.8), None])
KITCHEN = scene_run("redkitchen", [(0.9, 0.2), (1.8, 0.4), (9.2, 0.5), (30.0, 7.0)])


def test_accuracy_by_scene_and_on_average() -> None:
    table = accuracy_table("7-Scenes", "sfm", [CHESS, KITCHEN])
    assert table.header == ("", "chess", "redkitchen", "average", "not localized")
    assert table.rows == (
        ("coarse", "1.600 / 0.600", "11.000 / 0.900", "6.300 / 0.750", "1 of 8"),
        ("aligned", "1.200 / 0.450", "8.250 / 0.675", "4.725 / 0.562", "1 of 8"),
        ("final", "0.800 / 0.300", "5.500 / 0.450", "3.150 / 0.375", "1 of 8"),
        ("GS-CPE, coarse (published)", "–", "0.74 / 0.32", "–", "–"),  # noqa: RUF001
        ("GS-CPE, final (published)", "–", "0.72 / 0.27", "–", "–"),  # noqa: RUF001
    )
    assert any("final: the mean" in note for note in table.notes)
    assert table.keys == ("coarse", "aligned", "final", "published", "published")
    final = table.records[2]
    assert final["scenes"]["redkitchen"]["median_position_cm"] == pytest.approx(5.5, abs=1e-6)
    assert final["average"]["median_rotation_degrees"] == pytest.approx(0.375, abs=1e-6)
    assert final["scenes"]["chess"] | {"queries": 4, "with_pose": 3} == final["scenes"]["chess"]


def test_another_ground_truth_has_its_own_table() -> None:
    tables = benchmark_tables([CHESS, KITCHEN])
    titles = [table.title for table in tables]
    assert [title.split(":")[0] for title in titles] == [
        *("7-Scenes, ground truth sfm", "7-Scenes, ground truth sfm"),
        *("7-Scenes, ground truth dslam", "7-Scenes, ground truth dslam"),
        "Seconds per query",
    ]
    # Everything moved along +x, and so did this truth: 1 cm less.
    assert tables[2].rows[2][1:3] == ("0.200 / 0.300", "4.500 / 0.450")
    assert not any("published" in row[0] for row in tables[2].rows)


def test_the_published_average_is_of_all_scenes() -> None:
    runs = [scene_run(scene, [(0.5, 0.1)]) for scene in published.SCENES]
    rows = accuracy_table("7-Scenes", "sfm", runs).rows
    assert rows[3][-2] == "1.08 / 0.31"
    assert rows[4][-2] == "0.91 / 0.29"
    for other in ({}, {"split": "every 4th"}):
        runs[3] = scene_run("office", [(0.5, 0.1)], setup=other)
        assert len(accuracy_table("7-Scenes", "sfm", runs).rows) == 3
    assert len(accuracy_table("12-Scenes", "sfm", runs[:3]).rows) == 3
    assert len(accuracy_table("7-Scenes", "sfm", [CHESS]).rows) == 3  # no number of it known


def test_shares_are_of_all_queries() -> None:
    table = shares_table("7-Scenes", "sfm", [CHESS, KITCHEN])
    assert table.header[1:] == ("10 cm / 5°", "5 cm / 5°", "2 cm / 2°", "1 cm / 1°")
    assert table.rows == (
        ("chess, coarse", "75.0%", "75.0%", "50.0%", "25.0%"),
        ("chess, aligned", "75.0%", "75.0%", "75.0%", "25.0%"),
        ("chess, final", "75.0%", "75.0%", "75.0%", "50.0%"),
        ("redkitchen, coarse", "50.0%", "50.0%", "25.0%", "0.0%"),
        ("redkitchen, aligned", "50.0%", "50.0%", "25.0%", "0.0%"),
        ("redkitchen, final", "75.0%", "50.0%", "50.0%", "25.0%"),
        ("average, coarse", "62.5%", "62.5%", "37.5%", "12.5%"),
        ("average, aligned", "62.5%", "62.5%", "50.0%", "12.5%"),
        ("average, final", "75.0%", "62.5%", "62.5%", "37.5%"),
    )


def test_runtime() -> None:
    table = runtime_table([CHESS, KITCHEN])
    assert table.header[1:] == ("features", "retrieval", "coarse", "refinement", "total")
    totals = [0.1, 1.4, 1.8, 2.2]
    assert table.rows[0] == (
        *("7-Scenes chess", "0.100 / 0.100", "0.200 / 0.200", "0.300 / 0.300"),
        *("0.400 / 0.400", f"{np.median(totals):.3f} / {np.mean(totals):.3f}"),
    )
    assert table.rows[-1][0] == "GS-CPE on an RTX A5000 (published)"
    assert table.rows[-1][3:] == ("1.255", "0.353", "1.608")
    assert table.records[2]["stages"]["retrieval"]["queries"] == 7
    assert "cores 2, split official" in table.notes


def test_followed_cameras_have_no_coarse_pose() -> None:
    run = scene_run("stairs", [(1.5, 0.1), (1.5, 0.2)], coarse=False)
    table = accuracy_table("7-Scenes", "sfm", [run])
    assert table.rows == (
        ("coarse", "–", "0 of 2"),  # noqa: RUF001
        ("aligned", "2.250 / 0.225", "0 of 2"),
        ("final", "1.500 / 0.150", "0 of 2"),
    )
    assert "coarse: without 2 localized queries that needed no coarse stage" in table.notes
    shares = shares_table("7-Scenes", "sfm", [run]).rows
    assert set(shares[0][1:]) == {"–"}  # noqa: RUF001
    assert shares[2][1:] == ("100.0%", "100.0%", "100.0%", "0.0%")


def test_nothing_was_localized(tmp_path: Path) -> None:
    write_tables([scene_run("fire", [None, None]), CHESS], tmp_path)
    text = (tmp_path / "tables.json").read_text()
    assert "NaN" not in text
    tables = json.loads(text)["tables"]
    assert tables[0]["rows"][2]["scenes"]["fire"]["median_position_cm"] is None
    assert tables[0]["rows"][2]["average"]["median_position_cm"] is None
    assert tables[1]["rows"][1]["within"][0]["share"] == 0.0
    rows = (tmp_path / "tables.txt").read_text().splitlines()
    final = next(row for row in rows if row.startswith("final "))
    assert re.split(r"\s{2,}", final) == [
        *("final", "–", "0.800 / 0.300", "–", "3 of 6"),  # noqa: RUF001
    ]


def test_maps_without_a_unit() -> None:
    run = scene_run("hall", [(0.5, 0.1), (1.5, 0.3)], unit=None)
    table = accuracy_table("7-Scenes", "sfm", [run, CHESS])
    assert table.rows[2][1:4] == ("0.01 u / 0.200", "0.800 / 0.300", "–")  # noqa: RUF001
    assert table.records[2]["scenes"]["hall"]["median_position_units"] == pytest.approx(0.01)
    assert set(shares_table("7-Scenes", "sfm", [run]).rows[1][1:]) == {"–"}  # noqa: RUF001


def test_a_truth_that_knows_none_of_the_photos(tmp_path: Path) -> None:
    """It costs no table: neither of the other truths nor of the other scenes."""
    other = replace(KITCHEN, truths={"sfm": {"elsewhere.png": np.eye(4)}})
    write_tables([CHESS, other], tmp_path)
    tables = json.loads((tmp_path / "tables.json").read_text())["tables"]
    assert list(tables[0]["rows"][2]["scenes"]) == ["chess"]
    assert tables[2]["notes"] == ["sfm has none of these photos of redkitchen: there are no errors"]
    for end in ("txt", "md", "tex"):
        assert "has none of these" in (tmp_path / f"tables.{end}").read_text()


def test_seconds_of_one_run_by_stage() -> None:
    table = stage_times_table(CHESS.details)
    assert [row[:2] for row in table.rows] == [
        *(("features", "4"), ("retrieval", "3"), ("coarse", "3")),
        *(("refinement", "3"), ("total", "4")),
    ]
    totals = [0.1, 1.4, 1.8, 2.2]
    assert table.rows[-1][2:] == (
        *(f"{np.median(totals):.3f}", f"{np.quantile(totals, 0.9):.3f}", "2.200", "100.0%"),
    )
    assert table.records[1]["share"] == pytest.approx(0.6 / 5.5)
    assert stage_times_table([]).rows == ()


def with_covariance(run: SceneRun) -> SceneRun:
    """Camera centres known to 2 mm (where a unit is a metre) in each direction, turns to 1
    mrad; nothing of those without a pose."""
    covariance = np.diag([4e-6] * 3 + [1e-6] * 3).tolist()
    common = {"reason": None, "reference": "r.png"}
    details = []
    for detail in run.details:
        if detail["status"] == "localized":
            details.append({**detail, **common, "covariance": covariance})
        else:
            details.append({**detail, **common, "reason": "too dark", "covariance": None})
    return replace(run, details=tuple(details))


def columns(table: Table) -> dict[str, tuple[str, ...]]:
    return dict(zip(table.header, zip(*table.rows, strict=True), strict=True))


def test_queries_with_their_uncertainty() -> None:
    run = with_covariance(CHESS)
    table = query_table(run)
    column = columns(table)
    assert column["coarse position, cm"] == ("0.80", "1.60", "2.40", NOTHING)
    assert column["final rotation, °"] == ("0.100", "0.300", "0.800", NOTHING)
    assert column["position sd, cm"] == ("0.35", "0.35", "0.35", NOTHING)
    degrees = f"{np.degrees(np.sqrt(3) * 1e-3):.3f}"
    assert column["rotation sd, °"] == (degrees, degrees, degrees, NOTHING)
    assert column["status, reason"][3] == "not localized: too dark"
    assert table.keys == ("localized", "localized", "localized", "refused")
    assert table.records[0]["sd_position_cm"] == pytest.approx(0.2 * np.sqrt(3))
    names = [name for name in table.header if "position" in name]
    alone = query_table(replace(run, truths={}))
    assert [name for name in alone.header if "position" in name] == names[2:]
    assert to_text([table]).splitlines()[2].startswith("photo  status, reason  ")


def test_errors_in_an_unknown_unit_are_not_rounded_away() -> None:
    run = with_covariance(scene_run("hall", [(0.04, 0.1), (150000.0, 0.3)], unit=None))
    column = columns(query_table(run))
    assert column["final position, units"] == ("0.0004", "1500")
    assert column["position sd, units"] == ("0.00346", "0.00346")


def test_numbers_with_significant_digits() -> None:
    texts = [significant_text(value) for value in (0.0, 0.0004, 1.2345, 999.4, 999.6, 123456.0)]
    assert texts == ["0", "0.0004", "1.23", "999", "1000", "123456"]
    assert significant_text(None) == significant_text(float("nan")) == NOTHING


def test_four_files_that_do_not_change(tmp_path: Path) -> None:
    more = [ablation_table("Ablation", [AblationRow("full", 0.5, 0.1)])]
    for folder in ("a/b", "c"):
        write_tables([CHESS, KITCHEN], tmp_path / folder, more)
    names = ["tables.json", "tables.md", "tables.tex", "tables.txt"]
    assert sorted(path.name for path in (tmp_path / "c").iterdir()) == names
    for name in names:
        text = (tmp_path / "c" / name).read_bytes()
        assert text == (tmp_path / "a" / "b" / name).read_bytes()
        assert b"Ablation" in text
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        write_tables([CHESS], tmp_path / "file")
    with pytest.raises(DatasetError, match="7-Scenes chess was run twice"):
        write_tables([CHESS, CHESS], tmp_path)
    assert benchmark_tables([]) == ()


def test_ablation() -> None:
    rows = [AblationRow("full", 0.1734, 0.054), AblationRow("nothing", float("nan"), float("nan"))]
    assert ablation_table("A", rows).rows == (
        ("full", "0.173", "0.054"),
        ("nothing", "–", "–"),  # noqa: RUF001
    )
    table = ablation_table("A", rows, with_published=True)
    assert table.rows[2:] == (
        ("full (published)", "1.02", "0.184"),
        ("without multi-scale (published)", "1.08", "0.197"),
        ("without mask (published)", "1.14", "0.191"),
    )
    assert json.loads(to_json([table]))["tables"][0]["rows"][1]["median_position_cm"] is None
    table = ablation_table("A", rows, with_published=True, metric=False)
    assert table.header[1] == "position (world units)"
    assert [row[1] for row in table.rows] == ["0.1734", "–"]  # noqa: RUF001
    assert "cm" not in to_json([table])


ODD = Table("T_1 & 50%", ("", "DSAC*|x"), (("a_b\\c", "5° <1>"),), ("~^#${}",), ({"x_cm": 1.0},))


def test_markdown_escapes() -> None:
    assert to_markdown([ODD]).splitlines() == [
        r"### T\_1 & 50%",
        "",
        r"|  | DSAC\*\|x |",
        "|---|---:|",
        r"| a\_b\\c | 5° \<1\> |",
        "",
        "~^#${}",
    ]


def test_latex_escapes() -> None:
    text = to_latex([ODD])
    assert r"\caption{T\_1 \& 50\%}" in text
    assert r" & DSAC*\textbar{}x \\" in text
    assert r"a\_b\textbackslash{}c & 5$^\circ$ \textless{}1\textgreater{} \\" in text
    assert r"{\footnotesize \textasciitilde{}\textasciicircum{}\#\$\{\}}" in text


def test_latex_is_balanced() -> None:
    text = to_latex(benchmark_tables([CHESS, KITCHEN]))
    for command in ("toprule", "midrule", "bottomrule", "begin{tabular}", "end{table}"):
        assert text.count(f"\\{command}") == 5
    bare = re.sub(r"\\[{}]", "", text)
    assert bare.count("{") == bare.count("}")
    assert text.isascii()
    for row in text.splitlines():
        if row.endswith(r"\\") and row.startswith("    "):
            assert len(re.findall(r"(?<!\\)&", row)) in (3, 4, 5)


def test_text_is_aligned() -> None:
    table = Table("T", ("", "long header"), (("a", "1"), ("bcd", "22")), ("note",))
    assert to_text([table, table]) == "\n\n".join([
        "T\n\n     long header\n---  -----------\na              1\nbcd           22\n\nnote"
    ] * 2) + "\n"  # fmt: skip


def test_rows_of_another_length() -> None:
    with pytest.raises(ValueError, match="another number of cells"):
        Table("T", ("", "a"), (("x",),))
    with pytest.raises(ValueError, match="2 keys for 1 rows"):
        Table("T", ("", "a"), (("x", "y"),), keys=("k", "k"))
    with pytest.raises(ValueError, match="no column is named 'b'"):
        Table("T", ("", "a"), (("x", "y"),), words=("b",))


def test_words_begin_at_the_left() -> None:
    table = Table("T", ("", "why", "n"), (("a", "since", "1"),), words=("why",))
    assert to_text([table]).splitlines()[2:] == ["   why    n", "-  -----  -", "a  since  1"]
    assert to_markdown([table]).splitlines()[3] == "|---|---|---:|"
    assert r"\begin{tabular}{llr}" in to_latex([table])
