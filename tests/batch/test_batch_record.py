# SPDX-License-Identifier: Apache-2.0
"""The record of what is finished: in any order, with the map and the settings that it was of."""

from __future__ import annotations

import json
import logging
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Iterator, Sequence, cast

import pytest
from batch_room import CAMERA

from gscpe.batch import (
    Crew,
    Detail,
    Fingerprint,
    Instructions,
    choose_workers,
    localize_with,
    read_details,
)
from gscpe.batch.details import failed_details
from gscpe.batch.fingerprint import (
    map_fingerprint,
    photo_fingerprint,
    settings_fingerprint,
)
from gscpe.cores import available_cores
from gscpe.errors import MapError, ModelError, OutputError, SettingsError
from gscpe.geometry import Camera
from gscpe.localization.settings import LocalizerSettings
from gscpe.refinement import RefinementSettings
from gscpe.scene.query_list import Query

QUERIES = tuple(Query(f"{name}.png", CAMERA) for name in "abcde")
HERE = Fingerprint("map 1", "settings 1")


class Backwards:
    """A crew that finishes the last query first, and is interrupted after some."""

    description = "backwards"
    image_folder = Path("nowhere")

    def __init__(self, fingerprint: Fingerprint | None = HERE, finishes: int = 99) -> None:
        self.fingerprint = fingerprint
        self.finishes = finishes
        self.seen: list[str] = []

    def run(self, queries: Sequence[Query]) -> Iterator[tuple[Query, Detail]]:
        for query in reversed(queries):
            if len(self.seen) == self.finishes:
                raise KeyboardInterrupt
            self.seen.append(query.name)
            yield query, failed_details(query, "it was not tried") | {"status": "not localized"}


def localize(crew: Backwards, folder: Path, **options: Any) -> list[Detail]:
    return localize_with(cast(Crew, crew), QUERIES, folder / "d.jsonl", **options)


def test_the_file_is_a_log_and_the_list_has_its_order(tmp_path: Path) -> None:
    details = localize(Backwards(), tmp_path)
    assert [detail["name"] for detail in details] == [query.name for query in QUERIES]
    lines = [json.loads(line) for line in (tmp_path / "d.jsonl").read_text().splitlines()]
    assert lines == details[::-1]
    assert {(line["map"], line["settings"]) for line in lines} == {("map 1", "settings 1")}


def test_an_interrupted_crew_leaves_what_is_finished(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        localize(Backwards(finishes=2), tmp_path)
    assert list(read_details(tmp_path / "d.jsonl")) == ["e.png", "d.png"]
    crew = Backwards()
    assert len(localize(crew, tmp_path, resume=True)) == 5
    assert crew.seen == ["c.png", "b.png", "a.png"]


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (Fingerprint("map 2", "settings 1"), "localizing 5 photos again: .* with another map "),
        (Fingerprint("map 1", "settings 2"), "localizing 5 photos again: .* with another matcher "),
    ],
)
def test_another_map_or_other_settings(
    other: Fingerprint, message: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    localize(Backwards(), tmp_path)
    crew = Backwards(other)
    with caplog.at_level(logging.WARNING):
        details = localize(crew, tmp_path, resume=True)
    assert len(crew.seen) == 5
    assert {(d["map"], d["settings"]) for d in details} == {(other.map, other.settings)}
    (record,) = caplog.records
    assert re.search(message, record.getMessage())
    again = Backwards(other)
    localize(again, tmp_path, resume=True)
    assert again.seen == []


@pytest.mark.parametrize("camera", [CAMERA.unsure(focal=0.01), replace(CAMERA, fx=CAMERA.fx + 1)])
def test_another_camera_or_one_known_otherwise(
    camera: Camera, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    localize(Backwards(), tmp_path)
    queries = (Query("a.png", camera), *QUERIES[1:])
    for seen in (["a.png"], []):
        crew = Backwards()
        with caplog.at_level(logging.WARNING):
            localize_with(cast(Crew, crew), queries, tmp_path / "d.jsonl", resume=True)
        assert crew.seen == seen
    (record,) = caplog.records
    assert re.search("localizing 1 photos again: their cameras are others", record.getMessage())


def test_details_of_before_there_were_fingerprints(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Done again where the map is known now, and kept where it is not."""
    localize(Backwards(None), tmp_path)
    assert "map" not in read_details(tmp_path / "d.jsonl")["a.png"]
    unknown, known = Backwards(None), Backwards()
    localize(unknown, tmp_path, resume=True)
    assert unknown.seen == []
    with caplog.at_level(logging.WARNING):
        localize(known, tmp_path, resume=True)
    assert len(known.seen) == 5
    assert "or this was not recorded" in caplog.text


def test_a_crews_system_error_is_not_taken_for_the_files(tmp_path: Path) -> None:
    class Broken(Backwards):
        def run(self, queries: Sequence[Query]) -> Iterator[tuple[Query, Detail]]:
            raise OSError("too many processes")
            yield

    with pytest.raises(OSError, match="too many processes"):
        localize(Broken(), tmp_path)
    (tmp_path / "d.jsonl").unlink(missing_ok=True)
    (tmp_path / "d.jsonl").mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        localize(Backwards(), tmp_path)


def test_fingerprints_change_with_what_counts(tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text('{"gaussians": 5}')
    before = map_fingerprint(tmp_path)
    assert map_fingerprint(str(tmp_path)) == before
    (tmp_path / "map.json").write_text('{"gaussians": 6}')
    assert map_fingerprint(tmp_path) != before
    with pytest.raises(MapError, match=r"no map\.json"):
        map_fingerprint(tmp_path / "nowhere")

    settings = LocalizerSettings()
    moved = replace(settings, retrieval_model="elsewhere.onnx")
    assert settings_fingerprint(moved, "sift") == settings_fingerprint(settings, "sift")
    deep = replace(settings, refinement=RefinementSettings(levels=1))
    for other in ((deep, "sift"), (settings, "xfeat"), (replace(settings, retrieved=9), "sift")):
        assert settings_fingerprint(*other) != settings_fingerprint(settings, "sift")


def test_a_matchers_file_counts_and_not_its_path(tmp_path: Path) -> None:
    def of(name: str) -> str:
        return settings_fingerprint(LocalizerSettings(), f"onnx:{tmp_path / name}")

    (tmp_path / "a.onnx").write_bytes(b"network")
    (tmp_path / "b.onnx").write_bytes(b"network")
    assert of("a.onnx") == of("b.onnx")
    (tmp_path / "b.json").write_text("{}")
    assert of("a.onnx") != of("b.onnx")
    with pytest.raises(ModelError, match=r"c\.onnx cannot be read"):
        of("c.onnx")


def test_a_photos_fingerprint_is_of_its_bytes(tmp_path: Path) -> None:
    """Not of its size and its time, which a copy may share."""
    (tmp_path / "a").write_bytes(b"one photo")
    (tmp_path / "b").write_bytes(b"one photo")
    (tmp_path / "c").write_bytes(b"one Photo")
    for name in "abc":
        os.utime(tmp_path / name, (1, 1))
    a, b, c = (photo_fingerprint(tmp_path / name) for name in "abc")
    assert a == b != c
    assert a is not None and len(a) == 12
    assert photo_fingerprint(tmp_path / "absent") is None
    assert photo_fingerprint(tmp_path) is None


def test_timeouts_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text("{}")
    for timeout in (0.0, -1.0, float("nan")):
        with pytest.raises(SettingsError, match="timeout must be positive"):
            Instructions.of(tmp_path, tmp_path, matcher="sift", timeout=timeout)


def test_how_many_workers_a_list_is_worth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As many as there are cores, photos, and memory for; one on a GPU."""
    (tmp_path / "map.json").write_text('{"gaussians": 1000000}')  # 1.5 GB a worker
    instructions = Instructions.of(tmp_path, tmp_path, matcher="sift", backend="cpu")
    monkeypatch.setenv("GSCPE_THREADS", "16")
    assert available_cores() == 16
    monkeypatch.setattr("gscpe.batch.choose._free_memory", lambda: None)
    assert choose_workers(instructions, 1000) == 16
    assert choose_workers(instructions, 40) == 5
    assert choose_workers(instructions, 1) == 1
    assert choose_workers(replace(instructions, backend="gl"), 1000) == 1
    monkeypatch.setattr("gscpe.batch.choose._free_memory", lambda: 6_100_000_000)
    assert choose_workers(instructions, 1000) == 4
    monkeypatch.setenv("GSCPE_THREADS", "many")
    with pytest.raises(SettingsError, match="GSCPE_THREADS"):
        choose_workers(instructions, 1000)
