# SPDX-License-Identifier: Apache-2.0
"""Photos of a room with a known answer are put together."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scenes import room
from walks import WALK_CAMERA, walk_poses, write_jpeg, write_walk

from gscpe.errors import OutputError, PhotoError, ReconstructionError
from gscpe.geometry.projection import project
from gscpe.poses import write_pose_file
from gscpe.reconstruction import Reconstruction, ReconstructionSettings, ScaleSource, reconstruct
from gscpe.scene import References
from gscpe.scene.colmap_model import read_colmap_references

COUNT = 9


@dataclass(frozen=True)
class Walk:
    """Photos, their true poses, and the model that was made of them, in the true frame."""

    photos: Path
    poses: dict[str, NDArray[np.float64]]
    known: Path
    folder: Path
    model: Reconstruction


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    root = tmp_path_factory.mktemp("walk")
    photos = root / "photos"
    poses = write_walk(photos, COUNT)
    elsewhere = room(7).shoot(WALK_CAMERA, walk_poses(3)[1], samples=2).uint8
    write_jpeg(photos / "elsewhere.jpg", elsewhere)
    write_jpeg(photos / "blank.jpg", np.full((180, 240, 3), 130, dtype=np.uint8))
    (photos / "broken.jpg").write_bytes(b"not a photo")
    known = root / "known.txt"
    wrong = dict(poses)
    wrong["IMG_0004.jpg"] = poses["IMG_0000.jpg"]  # one mistake does no harm
    write_pose_file(known, wrong, "hloc")
    folder = root / "model"
    model = reconstruct(photos, folder, scale=ScaleSource.parse(str(known)))
    return Walk(photos, poses, known, folder, model)


def centres(poses: Any) -> NDArray[np.float64]:
    return np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in poses])


def way_of(references: References, walk: Walk) -> NDArray[np.float64]:
    """How far apart the first and the last photo are, as found and in truth; (2,)."""
    poses = references.cam_from_world, [walk.poses[name] for name in references.names]
    return np.array([np.linalg.norm(np.ptp(centres(each)[[0, -1]], axis=0)) for each in poses])


def test_all_photos_are_placed_where_they_were_taken(walk: Walk) -> None:
    assert walk.model.placed == tuple(walk.poses)
    assert walk.model.frame.metres_per_unit == 1.0
    references = read_colmap_references(walk.model.model_folder, walk.model.image_folder)
    truth = centres([walk.poses[name] for name in references.names])
    away = np.linalg.norm(centres(references.cam_from_world) - truth, axis=1)
    assert np.median(away) < 0.02
    assert away.max() < 0.06  # the walk is a metre long
    assert references.cameras[0].fx == pytest.approx(WALK_CAMERA.fx, rel=0.05)
    sizes = {(camera.width, camera.height) for camera in references.cameras}
    assert sizes == {(240, 180)}, "photos that were stored turned are upright"


def test_what_was_not_placed_has_a_reason(walk: Walk) -> None:
    reasons = walk.model.not_placed
    assert set(reasons) == {"elsewhere.jpg", "blank.jpg", "broken.jpg"}
    assert "another photo" in reasons["elsewhere.jpg"]
    assert "blurred" in reasons["blank.jpg"] or "features" in reasons["blank.jpg"]
    assert "decoded" in reasons["broken.jpg"]
    written = json.loads((walk.folder / "reconstruction.json").read_text())
    assert written["not_placed"] == reasons
    assert written["placed"] == list(walk.model.placed)


def test_resuming_does_nothing_again_and_may_change_the_unit(walk: Walk) -> None:
    scale = ScaleSource.parse("distance:IMG_0000.jpg,IMG_0008.jpg,50")
    again = reconstruct(walk.photos, walk.folder, scale=scale, resume=True)
    assert again.seconds == {}
    assert again.placed == walk.model.placed
    references = read_colmap_references(again.model_folder, again.image_folder)
    first, last = centres(references.cam_from_world[[0, -1]])
    assert np.linalg.norm(first - last) == pytest.approx(50.0)

    unknown = reconstruct(walk.photos, walk.folder, resume=True)
    assert unknown.frame.metres_per_unit is None
    assert unknown.frame.up == (0.0, 0.0, 1.0)
    references = read_colmap_references(unknown.model_folder, unknown.image_folder)
    for name, pose in zip(references.names, references.cam_from_world, strict=True):
        up_in_cam = walk.poses[name][:3, :3] @ (0.0, -1.0, 0.0)  # the room's y axis points down
        assert pose[:3, :3] @ (0.0, 0.0, 1.0) @ up_in_cam > np.cos(np.radians(5))

    with pytest.raises(OutputError, match="other settings"):
        reconstruct(walk.photos, walk.folder, ReconstructionSettings(seed=1), resume=True)
    with pytest.raises(ReconstructionError, match="was not placed"):
        scale = ScaleSource.parse("distance:IMG_0000.jpg,blank.jpg,50")
        reconstruct(walk.photos, walk.folder, scale=scale, resume=True)
    with pytest.raises(ReconstructionError, match="GPS position"):
        reconstruct(walk.photos, walk.folder, scale=ScaleSource("gps"), resume=True)


def test_the_unit_of_depth_images(walk: Walk, tmp_path: Path) -> None:
    """Half as large as the photos, in parts of 1/5000 m, with holes; then they do not belong."""
    names = ("IMG_0001.jpg", "IMG_0003.jpg", "IMG_0006.jpg")
    for i, name in enumerate(names):
        depth = room().shoot(WALK_CAMERA, walk.poses[name]).depth[::2, ::2]
        stored = np.rint(5000 * np.nan_to_num(depth, posinf=0.0)).astype(np.uint16)
        stored[:10] = (0, 65535, 0)[i]
        cv2.imwrite(str(tmp_path / Path(name).with_suffix(".png")), stored)
    scale = ScaleSource.parse(f"depth:{tmp_path},5000")
    again = reconstruct(walk.photos, walk.folder, scale=scale, resume=True)
    assert again.frame.metres_per_unit == 1.0
    references = read_colmap_references(again.model_folder, again.image_folder)
    ours, truth = way_of(references, walk)
    # Depths are right; where the focal length is too short, so are they against the steps aside.
    shorter = references.cameras[0].fx / WALK_CAMERA.fx
    assert ours * shorter == pytest.approx(truth, rel=0.02)

    for name in names:
        blocks = np.random.default_rng(0).uniform(200, 60000, (9, 12)).astype(np.uint16)
        noise = np.kron(blocks, np.ones((20, 20), np.uint16))
        cv2.imwrite(str(tmp_path / Path(name).with_suffix(".png")), noise)
    with pytest.raises(ReconstructionError, match="do not fit the model"):
        reconstruct(walk.photos, walk.folder, scale=scale, resume=True)
    colours = np.zeros((90, 120, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "IMG_0001.png"), colours)
    with pytest.raises(ReconstructionError, match="16 bits"):
        reconstruct(walk.photos, walk.folder, scale=scale, resume=True)
    cv2.imwrite(str(tmp_path / "IMG_0001.png"), np.zeros((120, 90), np.uint16))
    with pytest.raises(ReconstructionError, match="shapes differ"):
        reconstruct(walk.photos, walk.folder, scale=scale, resume=True)
    for name in names:
        (tmp_path / Path(name).with_suffix(".png")).unlink()
    with pytest.raises(ReconstructionError, match=r"no depth image.*IMG_0000.png"):
        reconstruct(walk.photos, walk.folder, scale=scale, resume=True)


def test_the_unit_of_a_length_that_photos_show(walk: Walk, tmp_path: Path) -> None:
    """Two corners of what is 2.5 m ahead, in photos of which one was stored turned."""
    ends = np.array([[-0.5, 0.2, 2.5], [0.4, -0.3, 2.3]])
    lines = [f"a,b,{np.linalg.norm(ends[0] - ends[1])}"]
    for name in ("IMG_0000.jpg", "IMG_0003.jpg", "IMG_0008.jpg"):
        pose = walk.poses[name]
        pixels = project(WALK_CAMERA, ends @ pose[:3, :3].T + pose[:3, 3])
        lines += [f"{point},{name},{x},{y}" for point, (x, y) in zip("ab", pixels, strict=True)]
    (tmp_path / "points.txt").write_text("\n".join(lines))
    scale = ScaleSource.parse(f"points:{tmp_path / 'points.txt'}")
    again = reconstruct(walk.photos, walk.folder, scale=scale, resume=True)
    assert again.frame.metres_per_unit == 1.0
    references = read_colmap_references(again.model_folder, again.image_folder)
    ours, truth = way_of(references, walk)
    assert ours == pytest.approx(truth, rel=0.03)


def test_photos_as_people_have_them(tmp_path: Path) -> None:
    """Blanks and other letters in names, copies, HEIC that is called JPEG, a broken link."""
    pillow_heif = pytest.importorskip("pillow_heif")
    shots = [room().shoot(WALK_CAMERA, pose, samples=2).uint8 for pose in walk_poses(5)]
    names = ("Küche 1.jpg", "Küche (2).JPG", "# 3.jpg", "sub dir/WhatsApp Bild um 12.03 4.jpg")
    for name, shot in zip(names, shots, strict=False):
        write_jpeg(tmp_path / "my photos" / name, shot)
    folder = tmp_path / "my photos"
    pillow_heif.from_pillow(Image.fromarray(shots[4])).save(folder / "from phone.HEIC", quality=95)
    (folder / "from phone.HEIC").rename(folder / "from phone.jpg")
    (folder / "Küche 1 - Copy.jpg").write_bytes((folder / "Küche 1.jpg").read_bytes())
    (folder / "notes of mine.txt").write_text("buy milk")
    (folder / "gone.jpg").symlink_to(tmp_path / "nowhere.jpg")
    not_utf8 = folder / os.fsdecode(b"caf\xe9.jpg")
    try:
        not_utf8.write_bytes((folder / "Küche 1.jpg").read_bytes())
    except OSError:  # this file system has none
        not_utf8 = folder
    result = reconstruct(folder, tmp_path / "my model")
    assert set(result.placed) == {*names, "from phone.jpg"}
    assert result.not_placed["Küche 1 - Copy.jpg"] == "is a copy of Küche 1.jpg"
    if not_utf8 != folder:
        assert "not UTF-8" in result.not_placed[not_utf8.name]
    references = read_colmap_references(result.model_folder, result.image_folder)
    assert set(references.names) == set(result.placed)


def test_too_few_photos(tmp_path: Path) -> None:
    write_walk(tmp_path / "photos", 2)
    with pytest.raises(ReconstructionError, match="2 usable photos are too few"):
        reconstruct(tmp_path / "photos", tmp_path / "model")
    with pytest.raises(ReconstructionError, match="no folder of photos"):
        reconstruct(tmp_path / "nothing", tmp_path / "model2")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ReconstructionError, match="neither photos"):
        reconstruct(tmp_path / "empty", tmp_path / "model3")


def test_all_blurred(tmp_path: Path) -> None:
    for i, pose in enumerate(walk_poses(3)):
        rgb = room().shoot(WALK_CAMERA, pose).uint8
        blurred = np.asarray(cv2.GaussianBlur(rgb, (0, 0), 6), dtype=np.uint8)
        write_jpeg(tmp_path / "photos" / f"{i}.jpg", blurred)
    with pytest.raises(ReconstructionError, match="all 3 photos are blurred"):
        reconstruct(tmp_path / "photos", tmp_path / "model")


def test_photos_that_do_not_overlap(tmp_path: Path) -> None:
    for seed in range(3):
        rgb = room(10 + seed).shoot(WALK_CAMERA, np.eye(4)).uint8
        write_jpeg(tmp_path / "photos" / f"{seed}.jpg", rgb)
    with pytest.raises(ReconstructionError, match="do not overlap"):
        reconstruct(tmp_path / "photos", tmp_path / "model")


def test_a_full_disk_is_told_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_walk(tmp_path / "photos", 3)
    nearly_full = SimpleNamespace(free=3_000_000)
    monkeypatch.setattr("shutil.disk_usage", lambda _: nearly_full)
    with pytest.raises(OutputError, match="make room"):
        reconstruct(tmp_path / "photos", tmp_path / "model")
    with pytest.raises(OutputError, match="interrupted"):
        reconstruct(tmp_path / "photos", tmp_path / "model")


def test_masks_of_other_photos(tmp_path: Path) -> None:
    write_walk(tmp_path / "photos", 3)
    masks = tmp_path / "masks"
    masks.mkdir()
    with pytest.raises(PhotoError, match="no mask"):
        reconstruct(tmp_path / "photos", tmp_path / "a", masks=masks)
    (masks / "IMG_0001.png").write_bytes(b"no image")
    with pytest.raises(PhotoError, match="decoded"):
        reconstruct(tmp_path / "photos", tmp_path / "b", masks=masks)
    cv2.imwrite(str(masks / "IMG_0001.png"), np.zeros((180, 180), np.uint8))
    with pytest.raises(PhotoError, match="shapes differ"):
        reconstruct(tmp_path / "photos", tmp_path / "c", masks=masks)
