# SPDX-License-Identifier: Apache-2.0
"""``gscpe localize``: one photo, lists of them, and going on after an interruption."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe import LocalizationResult, Localizer, PosePrior
from gscpe.cli.main import main
from gscpe.geometry import Camera, pose_difference, se3
from gscpe.localization import Observer
from gscpe.photos import read_image, write_image
from gscpe.photos.orientation import inverse_orientation, swaps_sides, turned_image
from gscpe.poses.hloc import format_pose, parse_pose, read_poses
from gscpe.scene import save_map

CAMERA = room_camera(240, 180)
CAMERA_WORDS = CAMERA.colmap_text()
POSES = {
    f"{name}.png": se3.exp(step) @ ROOM_POSE
    for name, step in {
        "a": [0.05, -0.03, 0.04, 0.02, -0.02, 0.03],
        "b": [-0.04, 0.02, 0.05, -0.02, 0.03, 0.0],
        "c": [0.0, 0.05, -0.02, 0.01, 0.0, -0.04],
    }.items()
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """room.gsmap, photos/ and queries.txt; one of the photos is of nowhere."""
    folder = tmp_path_factory.mktemp("localize")
    save_map(room_map(), folder / "room.gsmap")
    for name, pose in POSES.items():
        write_image(folder / "photos" / name, room().shoot(CAMERA, pose).uint8)
    write_image(folder / "photos" / "nowhere.png", np.full((180, 240, 3), 9, np.uint8))
    lines = [f"{name} {CAMERA_WORDS}\n" for name in (*POSES, "nowhere.png")]
    (folder / "queries.txt").write_text("".join(lines))
    return folder


def localize_list(folder: Path, output: Path, *more: str) -> int:
    return main(
        [
            *("localize", str(folder / "room.gsmap"), "--queries", str(folder / "queries.txt")),
            *("--images", str(folder / "photos"), "--output", str(output), *more),
        ]
    )


def check(pose: NDArray[np.float64], name: str) -> None:
    error = pose_difference(pose, POSES[name])
    assert error.distance < 4e-3
    assert error.degrees < 0.1


def test_one_photo(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo = str(folder / "photos" / "a.png")
    status = main(["localize", str(folder / "room.gsmap"), photo, "--camera", CAMERA_WORDS])
    out, err = capsys.readouterr()
    assert status == 0
    (pose,) = out.splitlines()
    check(parse_pose(pose), "a.png")
    (deviations,) = err.splitlines()
    assert deviations.startswith("standard deviations: ")
    lengths = [float(word) for word in deviations.split()[2:5]]
    assert all(1e-6 < length < 0.05 for length in lengths), deviations


def test_the_picture_of_one_photo(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photo = str(folder / "photos" / "a.png")
    words = ("localize", str(folder / "room.gsmap"), photo, "--camera", CAMERA_WORDS)
    assert main([*words, "--pictures", str(tmp_path / "new")]) == 0
    strip = read_image(tmp_path / "new" / "a.png")
    assert strip.shape == (26 + 180, 3 * 240, 3)
    photo_part, render, difference = (strip[26:, 240 * i : 240 * (i + 1)] for i in range(3))
    assert np.array_equal(photo_part, read_image(photo))
    apart = np.abs(photo_part.astype(float) - render)
    assert 0 < np.median(apart) < 6  # there are holes beside what the map's one photo saw
    assert 0 < np.median(difference) < 4 * 6
    assert "a.png: photo, render and difference" in capsys.readouterr().err
    # The folder of the photo itself would be overwritten.
    assert main([*words, "--pictures", str(folder / "photos")]) == 2
    assert "would overwrite the photo a.png" in capsys.readouterr().err
    assert np.array_equal(photo_part, read_image(photo))


def test_the_pictures_of_a_list(folder: Path, tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    assert localize_list(folder, tmp_path / "p.txt", "--pictures", str(pictures)) == 0
    sizes = {path.name: read_image(path).shape[1] for path in sorted(pictures.iterdir())}
    # Of what was not recognized there is the photo alone.
    assert sizes == {"a.png": 720, "b.png": 720, "c.png": 720, "nowhere.png": 240}


def test_one_photo_as_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo = str(folder / "photos" / "b.png")
    camera = CAMERA_WORDS.replace(" ", ",")
    status = main(["localize", str(folder / "room.gsmap"), photo, "--camera", camera, "--json"])
    out, err = capsys.readouterr()
    assert (status, err) == (0, "")
    detail = json.loads(out)
    assert (detail["name"], detail["status"], detail["reason"]) == (photo, "localized", None)
    check(parse_pose(detail["cam_from_world"]), "b.png")
    assert detail["reference"] == "room.png"
    assert detail["aligned"]["agreement"] > 0.8


def photo_with_lens(path: Path, millimetres: int) -> Path:
    """A JPEG of a 33 mm lens that claims to be of another."""
    square = Camera.pinhole(240, 180, fx=230.0, fy=230.0, cx=120.0, cy=90.0)
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = millimetres
    shot = room().shoot(square, POSES["a.png"], samples=2).uint8
    Image.fromarray(shot).save(path, quality=95, exif=exif)
    return path


def test_one_photo_of_an_unknown_camera(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From a lens in the EXIF block that is 15% too long; and what is printed can be given as
    --camera."""
    photo = photo_with_lens(tmp_path / "a.jpg", 38)
    arguments = ["localize", str(folder / "room.gsmap"), str(photo)]
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    line, _ = err.splitlines()
    assert line.startswith("camera estimated: OPENCV,240,180,")
    text = line.removeprefix("camera estimated: ")
    camera = Camera.parse(text)
    assert camera.fx == pytest.approx(230.0, rel=0.02)
    assert camera.fy == pytest.approx(camera.fx, rel=0.005)
    assert np.hypot(camera.cx - 120.0, camera.cy - 90.0) < 4.0
    error = pose_difference(parse_pose(out.strip()), POSES["a.png"])
    assert error.distance < 0.05
    assert error.degrees < 0.2
    assert main([*arguments, "--camera", text]) == 0
    again = capsys.readouterr()
    assert again.out == out
    assert again.err.startswith("standard deviations: ")


def test_a_lens_that_cannot_be(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The search begins at the lens of the EXIF block, and 6 times as long is too far."""
    photo = photo_with_lens(tmp_path / "a.jpg", 200)
    assert main(["localize", str(folder / "room.gsmap"), str(photo)]) == 1
    assert "focal length cannot be estimated" in capsys.readouterr().err


def test_an_unknown_camera_of_nowhere(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo = str(folder / "photos" / "nowhere.png")
    assert main(["localize", str(folder / "room.gsmap"), photo]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith(
        f"{photo}: not localized: the camera's focal length cannot be estimated: "
    )
    assert line.endswith("the photo is almost black (brightest value 9 of 255): expose it longer")


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_a_photo_that_is_stored_turned(
    orientation: int, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As phones store it. Without a camera, or with that of the photo as it is shown, the pose is
    that of the photo as it is shown."""
    photo = photo_with_lens(tmp_path / "a.jpg", 33)
    with Image.open(photo) as image:
        pixels, exif = np.asarray(image), image.getexif()
    exif[0x0112] = orientation
    stored = turned_image(pixels, inverse_orientation(orientation))
    Image.fromarray(stored).save(tmp_path / "b.jpg", quality=95, exif=exif)
    arguments = ["localize", str(folder / "room.gsmap"), str(tmp_path / "b.jpg")]
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    assert " OPENCV,240,180," in err
    assert pose_difference(parse_pose(out.strip()), POSES["a.png"]).distance < 0.05
    if swaps_sides(orientation):
        assert main([*arguments, "--camera", "PINHOLE,240,180,230,230,120,90"]) == 0
        check(parse_pose(capsys.readouterr().out.strip()), "a.png")


def test_a_prior_saves_retrieval(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo = str(folder / "photos" / "a.png")
    arguments = ["localize", str(folder / "room.gsmap"), photo, "--camera", CAMERA_WORDS, "--json"]
    near = format_pose(se3.exp([0.02, 0, 0, 0, 0.01, 0]) @ POSES["a.png"])
    for sigma, start in ((["0.05", "2"], "tracking"), (["0.5", "20"], "prior")):
        assert main([*arguments, "--prior", near, "--prior-sigma", *sigma]) == 0
        detail = json.loads(capsys.readouterr().out)
        assert detail["started_from"] == start
        check(parse_pose(detail["cam_from_world"]), "a.png")
    assert main([*arguments, "--prior", "1 0 0 0 nan 0 0"]) == 2
    assert main([*arguments, "--prior", near, "--prior-sigma", "0", "1"]) == 2
    with pytest.raises(SystemExit):
        main([*arguments, "--prior-sigma", "1", "1"])


@pytest.mark.parametrize("backend", ["gl", "cpu"])
def test_backends(backend: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo = str(folder / "photos" / "a.png")
    arguments = ["localize", str(folder / "room.gsmap"), photo, "--camera", CAMERA_WORDS]
    assert main([*arguments, "--backend", backend]) == 0
    check(parse_pose(capsys.readouterr().out), "a.png")


@pytest.mark.parametrize("form", [[], ["--json"]])
def test_a_photo_of_nowhere(
    form: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit status 1, and why."""
    photo = str(folder / "photos" / "nowhere.png")
    arguments = ["localize", str(folder / "room.gsmap"), photo, "--camera", CAMERA_WORDS]
    assert main([*arguments, *form]) == 1
    out, err = capsys.readouterr()
    if form:
        detail = json.loads(out)
        assert detail["status"] == "not localized"
        assert detail["reason"]
        assert detail["cam_from_world"] is None
    else:
        assert out == ""
        assert err.startswith(f"{photo}: not localized: ")
        assert len(err.splitlines()) == 1


def test_a_list(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output, coarse, details = (tmp_path / n for n in ("new/p.txt", "c.txt", "d.jsonl"))
    more = ("--coarse-output", str(coarse), "--details", str(details))
    assert localize_list(folder, output, *more) == 0
    out, err = capsys.readouterr()
    assert err.startswith("1 not localized: nowhere.png: the photo is almost black")
    assert len(err.splitlines()) == 1
    assert out == f"3 of 4 photos localized: {output}; details: {details}\n"
    for path in (output, coarse):
        poses = read_poses(path)
        assert list(poses) == list(POSES)
        for name, pose in poses.items():
            check(pose, name)
    lines = [json.loads(line) for line in details.read_text().splitlines()]
    assert [line["name"] for line in lines] == [*POSES, "nowhere.png"]
    assert [line["status"] for line in lines] == ["localized"] * 3 + ["not localized"]


class Interrupting(Localizer):
    """The real localizer, until somebody presses Ctrl-C at the third photo."""

    photos = 0

    def localize(
        self,
        image: NDArray[np.uint8],
        camera: Camera,
        prior: PosePrior | LocalizationResult | None = None,
        references: Sequence[str] | None = None,
        observer: Observer | None = None,
    ) -> LocalizationResult:
        if Interrupting.photos == 2:
            raise KeyboardInterrupt
        Interrupting.photos += 1
        return super().localize(image, camera, prior, references, observer)


def test_going_on_after_an_interruption(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    output = tmp_path / "poses.txt"
    monkeypatch.setattr("gscpe.batch.worker.Localizer", Interrupting)
    monkeypatch.setattr(Interrupting, "photos", 0)
    assert localize_list(folder, output) == 130
    out, err = capsys.readouterr()
    assert out == ""
    assert "2 of 4 photos are finished; run the same again with resume (--resume)" in err
    assert "gscpe localize: interrupted" in err
    assert "Traceback" not in err
    assert list(read_poses(output)) == ["a.png", "b.png"]

    details = output.with_suffix(".details.jsonl")
    first = details.read_text().splitlines()
    assert len(first) == 2
    monkeypatch.undo()
    assert localize_list(folder, output, "--resume") == 0
    assert capsys.readouterr().out.startswith("3 of 4 photos localized")
    again = details.read_text().splitlines()
    assert again[:2] == first  # not done again
    assert list(read_poses(output)) == list(POSES)


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["a.png", "--queries", "q.txt"],
        ["--queries", "q.txt"],
        ["--queries", "q.txt", "--images", "photos"],
        ["--queries", "q.txt", "--output", "poses.txt"],
        ["a.png", "--camera", CAMERA_WORDS, "--backend", "vulkan"],
    ],
)
def test_arguments_that_do_not_fit(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["localize", "room.gsmap", *arguments])
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "Traceback" not in err
    assert "gscpe localize: error: " in err.splitlines()[-1]
