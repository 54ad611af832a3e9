# SPDX-License-Identifier: Apache-2.0
"""Splits as documented, subsets and copies of data sets, and every missing file named."""

from __future__ import annotations

import json
import logging
import shutil
import sys
from pathlib import Path
from typing import Any, Callable

import dataset_folders as folders
import numpy as np
import pytest
from scenes import write_colmap_model

from gscpe.datasets import (
    Dataset,
    read_cambridge,
    read_colmap,
    read_fast_livo2,
    read_rgbd_folder,
    read_seven_scenes,
    read_transforms,
)
from gscpe.datasets.dataset import OFFICIAL
from gscpe.errors import ColmapModelError, DatasetError, MissingDependencyError, SettingsError
from gscpe.geometry import Camera
from gscpe.poses.hloc import format_pose
from gscpe.scene.query_list import Query


def kitchen(root: Path) -> Dataset:
    return read_seven_scenes(root, "redkitchen")


def college(root: Path) -> Dataset:
    return read_cambridge(root, "KingsCollege")


def building(root: Path) -> Dataset:
    return read_fast_livo2(root, "CBD_Building_01")


def query_names(dataset: Dataset) -> list[str]:
    return [query.name for query in dataset.queries]


# --- Missing files


@pytest.mark.parametrize(
    ("write", "read", "lost", "source"),
    [
        (folders.write_seven_scenes, kitchen, "redkitchen", "microsoft.com"),
        (folders.write_seven_scenes, kitchen, "redkitchen/TrainSplit.txt", "microsoft.com"),
        (folders.write_seven_scenes, kitchen, "redkitchen/TestSplit.txt", "microsoft.com"),
        (folders.write_seven_scenes, kitchen, "redkitchen/seq-03", "microsoft.com"),
        (folders.write_seven_scenes, kitchen, "pgt/sfm/7scenes/redkitchen_train.txt", "tsattler"),
        (folders.write_seven_scenes, kitchen, "pgt/sfm/7scenes/redkitchen_test.txt", "tsattler"),
        (folders.write_cambridge, college, "KingsCollege", "cam.ac.uk"),
        (folders.write_cambridge, college, "KingsCollege/dataset_train.txt", "cam.ac.uk"),
        (folders.write_cambridge, college, "KingsCollege/dataset_test.txt", "cam.ac.uk"),
        (folders.write_cambridge, college, "KingsCollege/reconstruction.nvm", "cam.ac.uk"),
        (folders.write_fast_livo2, building, "CBD_Building_01/images", "hku-mars"),
        (folders.write_fast_livo2, building, "CBD_Building_01/trajectory.txt", "hku-mars"),
        (folders.write_fast_livo2, building, "CBD_Building_01/camera_pinhole.yaml", "hku-mars"),
        (folders.write_transforms, read_transforms, "transforms.json", "ns-process-data"),
        (folders.write_transforms, read_transforms, "images", "transforms.json"),
        (folders.write_rgbd_folder, read_rgbd_folder, "rgb", "docs/datasets.md"),
        (folders.write_rgbd_folder, read_rgbd_folder, "camera.txt", "docs/datasets.md"),
        (folders.write_rgbd_folder, read_rgbd_folder, "poses", "trajectory.txt"),
    ],
)
def test_a_missing_file_is_named_with_its_source(
    write: Callable[[Path], Any],
    read: Callable[[Path], Dataset],
    lost: str,
    source: str,
    tmp_path: Path,
) -> None:
    write(tmp_path)
    read(tmp_path)
    path = tmp_path / lost
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(DatasetError) as caught:
        read(tmp_path)
    assert str(path) in str(caught.value)
    assert source in str(caught.value)


def test_missing_yaml_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders.write_fast_livo2(tmp_path)
    monkeypatch.setitem(sys.modules, "yaml", None)
    with pytest.raises(MissingDependencyError, match=r"gscpe\[datasets\]"):
        building(tmp_path)


# --- 7-Scenes


def test_seven_scenes_split_and_truths(tmp_path: Path) -> None:
    true, slam = folders.some_poses(), folders.some_poses(seed=4)
    poses = folders.write_seven_scenes(tmp_path, true, original=slam)
    sfm = kitchen(tmp_path)
    assert all(name.startswith("seq-01/") for name in sfm.references.names)
    assert all(name.startswith("seq-03/") for name in query_names(sfm))
    assert list(sfm.truths) == ["sfm", "original"]
    original = read_seven_scenes(tmp_path, "redkitchen", "original")
    assert list(original.truths) == ["original", "sfm"]
    for dataset in (sfm, original):
        for i, name in enumerate(sorted(poses)):
            np.testing.assert_allclose(dataset.truths["sfm"][name], poses[name], atol=1e-9)
            np.testing.assert_allclose(dataset.truths["original"][name], slam[i], atol=1e-6)
    first = original.truths["original"][original.references.names[0]]
    np.testing.assert_array_equal(original.references.cam_from_world[0], first)


def test_seven_scenes_is_official_only_when_it_is_whole(tmp_path: Path) -> None:
    folders.write_seven_scenes(tmp_path)
    assert kitchen(tmp_path).split == OFFICIAL
    photos = sorted((tmp_path / "redkitchen").glob("seq-*/frame-*.color.png"))
    photos[0].unlink()
    assert kitchen(tmp_path).split == f"{OFFICIAL}, incomplete"


def test_seven_scenes_without_pseudo_ground_truth(tmp_path: Path) -> None:
    folders.write_seven_scenes(tmp_path)
    shutil.rmtree(tmp_path / "pgt")
    dataset = read_seven_scenes(tmp_path, "redkitchen", "original")
    assert list(dataset.truths) == ["original"]
    assert dataset.queries[0].camera == Camera.pinhole(64, 48, fx=525, fy=525, cx=32, cy=24)


@pytest.mark.parametrize("place", ["redkitchen", "."])
def test_seven_scenes_pseudo_ground_truth_in_other_places(place: str, tmp_path: Path) -> None:
    folders.write_seven_scenes(tmp_path, pgt=place)
    assert list(kitchen(tmp_path).truths) == ["sfm", "original"]
    with pytest.raises(DatasetError, match="elsewhere"):
        read_seven_scenes(tmp_path, "redkitchen", pgt_folder=tmp_path / "elsewhere")
    with pytest.raises(SettingsError):
        read_seven_scenes(tmp_path, "redkitchen", "slam")  # type: ignore[arg-type]


def test_seven_scenes_subset_of_jpg_copies(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Photos on disk count; poses that are damaged or not finite are left out, with one line."""
    poses = folders.write_seven_scenes(tmp_path, ending=".jpg")
    folder = tmp_path / "redkitchen"
    (folder / "seq-01/frame-000000.color.jpg").unlink()
    (folder / "TrainSplit.txt").write_text("sequence1\r\nsequence2\r\n")
    (folder / "seq-01/frame-000001.pose.txt").write_text("1 0 0")
    (folder / "seq-03/frame-000002.pose.txt").write_text("-1.#IND " * 16)
    (folder / "seq-03/frame-000003.pose.txt").write_text(" ".join(["nan"] * 16))
    with caplog.at_level(logging.WARNING):
        sfm = kitchen(tmp_path)
    assert set(sfm.references.names) | set(query_names(sfm)) == set(poses) - {
        "seq-01/frame-000000.color.jpg"
    }
    assert "seq-02" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="gscpe.datasets.assembly"):
        original = read_seven_scenes(tmp_path, "redkitchen", "original")
    assert len(original.references) == 2
    assert query_names(original) == [f"seq-03/frame-00000{i}.color.jpg" for i in (0, 1)]
    records = [r for r in caplog.records if r.name == "gscpe.datasets.assembly"]
    assert len(records) == 1
    assert "3 of 7 photos" in records[0].getMessage()


def test_seven_scenes_still_zipped(tmp_path: Path) -> None:
    folders.write_seven_scenes(tmp_path)
    shutil.rmtree(tmp_path / "redkitchen/seq-01")
    (tmp_path / "redkitchen/seq-01.zip").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"unpack seq-01\.zip"):
        kitchen(tmp_path)


# --- Cambridge


def test_cambridge_split_and_subset(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folders.write_cambridge(tmp_path)
    (tmp_path / "KingsCollege/seq1/frame00001.png").unlink()
    photo = tmp_path / "KingsCollege/seq2/frame00005.png"
    folders.write_photo(photo.with_suffix(".jpg"))
    photo.unlink()
    with caplog.at_level(logging.WARNING):
        dataset = college(tmp_path)
    assert dataset.references.names == tuple(f"seq1/frame0000{i}.png" for i in (2, 3, 4))
    assert query_names(dataset)[0] == "seq2/frame00005.jpg"
    assert len(dataset.queries) == 4
    assert "1 of 8 photos" in caplog.text


@pytest.mark.parametrize(
    "folder",
    [
        "KingsCollege/sparse/0",
        "KingsCollege/sparse",
        "CambridgeLandmarks_Colmap_Retriangulated_1024px/KingsCollege/empty_all",
    ],
)
def test_cambridge_intrinsics_of_a_colmap_model(folder: str, tmp_path: Path) -> None:
    """Of scaled photos, as hloc's: the camera is scaled up to the photo."""
    poses = folders.write_cambridge(tmp_path)
    (tmp_path / "KingsCollege/reconstruction.nvm").unlink()
    half = Camera.parse("SIMPLE_RADIAL 32 24 27.5 16 12 -0.05")
    write_colmap_model(tmp_path / folder, half, poses)
    dataset = college(tmp_path)
    for camera in (*dataset.references.cameras, *(query.camera for query in dataset.queries)):
        assert camera == Camera.parse("SIMPLE_RADIAL 64 48 55 32 24 -0.05")


def test_cambridge_train_and_test_models(tmp_path: Path) -> None:
    poses = folders.write_cambridge(tmp_path)
    (tmp_path / "KingsCollege/reconstruction.nvm").unlink()
    camera = Camera.parse("PINHOLE 64 48 55 55 32 24")
    for split, sequence in (("train", "seq1"), ("test", "seq2")):
        part = {name: pose for name, pose in poses.items() if name.startswith(sequence)}
        write_colmap_model(tmp_path / f"KingsCollege/model_{split}", camera, part)
    assert college(tmp_path).queries[0].camera == camera


# --- FAST-LIVO2


def test_fast_livo2_split_is_one_to_three(tmp_path: Path) -> None:
    names = sorted(folders.write_fast_livo2(tmp_path))
    dataset = building(tmp_path)
    assert query_names(dataset) == names[::4]
    assert len(dataset.references) == 3 * len(dataset.queries)


def test_fast_livo2_poses_are_interpolated_near_stamps_only(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A turn at constant speed is met exactly; a gap and the ends are left out."""
    scene = tmp_path / "CBD_Building_01"
    folders.write_fast_livo2(tmp_path, extrinsics=False)
    shutil.rmtree(scene / "images")

    def pose_at(t: float) -> folders.Pose:
        angle, pose = 0.8 * t, np.eye(4)
        pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        pose[:3, 3] = [2.0 * t, -t, 0.5]
        return pose

    stamps = [0.0, 0.1, 0.2, 0.3, 0.55, 0.65, 0.75]
    lines = [folders.tum_line(10 + t, pose_at(t)) for t in stamps]
    folders.write_lines(scene / "trajectory.txt", ["# stamp", *lines[::-1]])
    kept, lost = (0.04, 0.1, 0.19, 0.25, 0.6, 0.7, 0.75), (-0.02, 0.35, 0.5, 0.9)
    for t in (*kept, *lost):
        folders.write_photo(scene / "images" / f"{10 + t:.6f}.png")
    with caplog.at_level(logging.WARNING):
        dataset = building(tmp_path)
    truth = dataset.truths["trajectory"]
    assert sorted(truth) == [f"{10 + t:.6f}.png" for t in kept]
    for t in kept:
        world_from_cam = np.linalg.inv(truth[f"{10 + t:.6f}.png"])
        np.testing.assert_allclose(world_from_cam, pose_at(t), atol=1e-6)
    assert "4 of 11 photos" in caplog.text
    shifted = read_fast_livo2(tmp_path, "CBD_Building_01", time_offset=0.02).truths["trajectory"]
    world_from_cam = np.linalg.inv(shifted["10.040000.png"])
    np.testing.assert_allclose(world_from_cam, pose_at(0.06), atol=1e-6)


def test_fast_livo2_calibrations_in_other_dresses(tmp_path: Path) -> None:
    """OpenCV's first line, and ROS 2's wrapping; a fisheye and another size are refused."""
    folders.write_fast_livo2(tmp_path)
    path = tmp_path / "CBD_Building_01/camera_pinhole.yaml"
    text = path.read_text()
    camera = building(tmp_path).queries[0].camera
    path.write_text("%YAML:1.0\n---\n" + text)
    assert building(tmp_path).queries[0].camera == camera
    inner = "".join(f"      {line}\n" for line in text.replace("cam_", "").splitlines())
    path.write_text("/**:\n  ros__parameters:\n    camera:\n" + inner)
    assert building(tmp_path).queries[0].camera == camera
    path.write_text(text.replace("Pinhole", "EquidistantCamera"))
    with pytest.raises(DatasetError, match="EquidistantCamera"):
        building(tmp_path)
    path.write_text(text.replace("cam_height: 96", "cam_height: 128"))
    with pytest.raises(DatasetError, match="is not a scaled 128x128"):
        building(tmp_path)


# --- COLMAP


@pytest.fixture
def model(tmp_path: Path) -> Path:
    poses = {f"{i:02d}.png": pose for i, pose in enumerate(folders.some_poses(17))}
    for name in poses:
        folders.write_photo(tmp_path / "images" / name)
    write_colmap_model(tmp_path / "sparse", Camera.parse("PINHOLE 64 48 55 55 32 24"), poses)
    return tmp_path


def test_colmap_every_nth(model: Path) -> None:
    dataset = read_colmap(model / "sparse", model / "images")
    assert query_names(dataset) == ["00.png", "08.png", "16.png"]
    assert dataset.metres_per_unit is None
    assert dataset.scene == model.name
    third = read_colmap(model / "sparse", model / "images", every=3, metres_per_unit=0.5)
    assert query_names(third) == [f"{i:02d}.png" for i in range(0, 17, 3)]
    assert third.metres_per_unit == 0.5


def test_colmap_test_list(model: Path) -> None:
    (model / "test.txt").write_text("# test\n03.png\n\n11.png\nunregistered.png\n")
    dataset = read_colmap(model / "sparse", model / "images", test_list=model / "test.txt")
    assert query_names(dataset) == ["03.png", "11.png"]
    assert len(dataset.references) == 15
    (model / "test.txt").write_text("elsewhere.png\n")
    with pytest.raises(DatasetError, match=r"test\.txt: no photo of"):
        read_colmap(model / "sparse", model / "images", test_list=model / "test.txt")


def test_colmap_with_a_query_list(model: Path) -> None:
    (true,) = folders.some_poses(1, seed=5)
    folders.write_photo(model / "queries/night/a.png")
    (model / "queries.txt").write_text(
        "night/a.png PINHOLE 64 48 50 50 32 24\nlost.png PINHOLE 64 48 50 50 32 24\n"
    )
    (model / "truth.txt").write_text(f"night/a.png {format_pose(true)}\n")
    queries, truths, folder = model / "queries.txt", model / "truth.txt", model / "queries"
    dataset = read_colmap(
        model / "sparse", model / "images", queries=queries, truth=truths, query_folder=folder
    )
    assert dataset.image_folder == model / "images"
    assert dataset.query_folder == folder
    assert query_names(dataset) == ["night/a.png"]  # as in the lists
    assert dataset.references.names[0] == "00.png"
    assert len(dataset.references) == 17
    assert dataset.queries[0].camera.fx == 50
    truth = dataset.truths["colmap"]["night/a.png"]
    np.testing.assert_allclose(truth, true, atol=1e-8)
    with pytest.raises(SettingsError, match="belong together"):
        read_colmap(model / "sparse", model / "images", queries=queries)
    with pytest.raises(SettingsError, match="not several"):
        read_colmap(model / "sparse", model / "images", every=3, test_list=model / "truth.txt")


def test_a_photo_of_another_size_is_refused(model: Path) -> None:
    """Whichever it is, with its name."""
    folders.write_photo(model / "images/05.png", (32, 24))
    with pytest.raises(ColmapModelError, match=r"05\.png is 32x24, but its camera is 64x48"):
        read_colmap(model / "sparse", model / "images", every=2)


def test_queries_of_half_the_size(model: Path) -> None:
    """Those of a list, in a folder of their own, beside references of the model's size."""
    folders.write_photo(model / "queries/my night.png", (32, 24))
    (model / "queries.txt").write_text("my night.png PINHOLE 64 48 50 50 32 24\n")
    (model / "truth.txt").write_text("my night.png 1 0 0 0 0 0 1\n")
    dataset = read_colmap(
        model / "sparse",
        model / "images",
        queries=model / "queries.txt",
        truth=model / "truth.txt",
        query_folder=model / "queries",
    )
    (query,) = dataset.queries
    assert query == Query("my night.png", Camera.pinhole(32, 24, fx=25, fy=25, cx=16, cy=12))
    assert dataset.references.cameras[0].width == 64


# --- nerfstudio


def test_transforms_split_lists(tmp_path: Path) -> None:
    names = sorted(folders.write_transforms(tmp_path))
    assert query_names(read_transforms(tmp_path)) == names[::8]
    assert query_names(read_transforms(tmp_path / "transforms.json", every=3)) == names[::3]
    train, test = ([f"./{name}" for name in listed] for listed in (names[:5], names[6:]))
    folders.write_transforms(tmp_path, train_filenames=train, test_filenames=test)
    dataset = read_transforms(tmp_path)
    assert query_names(dataset) == names[6:]
    assert list(dataset.references.names) == names[:5]
    assert query_names(read_transforms(tmp_path, every=4)) == names[::4]


def test_blender_folder(tmp_path: Path) -> None:
    """Split by file, names without endings, and a field of view."""
    folders.write_transforms(tmp_path, camera={"camera_angle_x": 0.9})
    tree = json.loads((tmp_path / "transforms.json").read_text())
    for frame in tree["frames"]:
        frame["file_path"] = frame["file_path"].removesuffix(".png")
    for split, part in (("train", tree["frames"][:6]), ("test", tree["frames"][6:])):
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps({**tree, "frames": part}))
    (tmp_path / "transforms.json").unlink()
    dataset = read_transforms(tmp_path)
    assert query_names(dataset) == ["images/frame_00007.png", "images/frame_00008.png"]
    assert len(dataset.references) == 6
    assert dataset.queries[0].camera.cx == 32.0


def test_transforms_beside_the_photos(tmp_path: Path) -> None:
    """Paths may lead out of the folder; values of a frame come before those of the file."""
    folders.write_transforms(tmp_path)
    tree = json.loads((tmp_path / "transforms.json").read_text())
    (tmp_path / "run").mkdir()
    for frame in tree["frames"]:
        frame["file_path"] = "../" + frame["file_path"]
    tree["frames"][0]["fl_x"] = 77.0
    (tmp_path / "run/transforms.json").write_text(json.dumps(tree))
    dataset = read_transforms(tmp_path / "run")
    assert dataset.image_folder == tmp_path
    assert dataset.queries[0].name == "images/frame_00001.png"
    assert dataset.queries[0].camera.fx == 77.0
    assert dataset.references.cameras[0].fx == 60.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_model": "OPENCV_FISHEYE"}, "OPENCV_FISHEYE is not supported"),
        ({"is_fisheye": True}, "fisheye is not supported"),
        ({"k4": 0.1}, "k4 is not supported"),
        ({"fl_x": "wide"}, "fl_x is not a number"),
        ({"fl_x": float("nan")}, "finite"),
        ({"w": 0}, "not a possible image size"),
        ({"w": 128, "h": 96}, "is 64x48, but its camera is 128x96"),
    ],
)
def test_transforms_cameras_that_are_refused(
    change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    folders.write_transforms(tmp_path, None, {**folders.TRANSFORMS_CAMERA, **change})
    with pytest.raises(DatasetError, match=message):
        read_transforms(tmp_path)


def changed_transforms(folder: Path, **extra: Any) -> tuple[dict[str, Any], Path]:
    folders.write_transforms(folder, **extra)
    path = folder / "transforms.json"
    return json.loads(path.read_text()), path


def test_transforms_of_windows(tmp_path: Path) -> None:
    """Backslashes in paths, lists of the split too; UTF-16 with a mark."""
    tree, path = changed_transforms(tmp_path, test_filenames=["images\\frame_00003.png"])
    for frame in tree["frames"]:
        frame["file_path"] = frame["file_path"].removeprefix("./").replace("/", "\\")
    path.write_text(json.dumps(tree), encoding="utf-16")
    dataset = read_transforms(tmp_path)
    assert query_names(dataset) == ["images/frame_00003.png"]
    assert len(dataset.references) == 7


def test_transforms_of_three_rows(tmp_path: Path) -> None:
    tree, path = changed_transforms(tmp_path)
    expected = read_transforms(tmp_path)
    for frame in tree["frames"]:
        del frame["transform_matrix"][3]
    path.write_text(json.dumps(tree))
    found = read_transforms(tmp_path)
    np.testing.assert_array_equal(
        found.references.cam_from_world, expected.references.cam_from_world
    )


@pytest.mark.parametrize("value", [float("nan"), None, "lost"])
def test_transforms_with_lost_frames(
    value: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Left out, with one warning that counts them; an error where nothing is left."""
    tree, path = changed_transforms(tmp_path)
    for frame in tree["frames"][2:4]:
        frame["transform_matrix"][1][3] = value
    path.write_text(json.dumps(tree))
    dataset = read_transforms(tmp_path)
    assert len(dataset.references) + len(dataset.queries) == 6
    assert set(dataset.truths["transforms"]).isdisjoint(
        ["images/frame_00003.png", "images/frame_00004.png"]
    )
    (warning,) = caplog.messages
    assert "2 of 8 photos have no usable pose" in warning
    for frame in tree["frames"]:
        frame["transform_matrix"][1][3] = value
    path.write_text(json.dumps(tree))
    with pytest.raises(DatasetError, match=r"frame 0 .*not a 4x4 matrix of finite numbers"):
        read_transforms(tmp_path)


def test_transforms_of_portraits_and_landscapes(tmp_path: Path) -> None:
    """Without w and h each photo has its own size, and its own focal length of one angle."""
    folders.write_transforms(tmp_path, camera={"camera_angle_x": 2 * np.arctan(0.5)})
    folders.write_photo(tmp_path / "images/frame_00004.png", (48, 64))
    dataset = read_transforms(tmp_path)
    cameras = dict(zip(dataset.references.names, dataset.references.cameras, strict=True))
    portrait = Camera.pinhole(48, 64, fx=48, fy=48, cx=24, cy=32)
    landscape = Camera.pinhole(64, 48, fx=64, fy=64, cx=32, cy=24)
    for name, camera in cameras.items():
        expected = portrait if name == "images/frame_00004.png" else landscape
        assert (camera.width, camera.height) == (expected.width, expected.height)
        np.testing.assert_allclose(camera.matrix(), expected.matrix(), atol=1e-9)


# --- RGB-D


def test_rgbd_folder_split_and_lost_frames(tmp_path: Path) -> None:
    names = sorted(folders.write_rgbd_folder(tmp_path))
    assert query_names(read_rgbd_folder(tmp_path)) == names[::8]
    (tmp_path / "poses/000000.txt").write_text("-inf " * 16)
    assert query_names(read_rgbd_folder(tmp_path, every=2)) == names[1::2]
    with pytest.raises(SettingsError, match="2 or more"):
        read_rgbd_folder(tmp_path, every=1)


def test_rgbd_matrices_of_three_rows(tmp_path: Path) -> None:
    folders.write_rgbd_folder(tmp_path)
    expected = read_rgbd_folder(tmp_path)
    for path in (tmp_path / "poses").glob("*.txt"):
        np.savetxt(path, np.loadtxt(path)[:3])
    found = read_rgbd_folder(tmp_path)
    np.testing.assert_allclose(
        found.references.cam_from_world, expected.references.cam_from_world, atol=1e-12
    )


def test_rgbd_order_needs_a_pose_a_photo(tmp_path: Path) -> None:
    names = sorted(folders.write_rgbd_folder(tmp_path, form="order"))
    (tmp_path / "rgb" / names[0]).unlink()
    with pytest.raises(DatasetError, match="has 8 poses, but"):
        read_rgbd_folder(tmp_path)


def test_rgbd_camera_line_of_colmap(tmp_path: Path) -> None:
    folders.write_rgbd_folder(tmp_path)
    camera = read_rgbd_folder(tmp_path).queries[0].camera
    (tmp_path / "camera.txt").write_text(f"# id model ...\n1 {folders.RGBD_CAMERA}\n")
    assert read_rgbd_folder(tmp_path).queries[0].camera == camera
    (tmp_path / "camera.txt").write_text("FOV 1 2 3\n")
    with pytest.raises(DatasetError, match=r"camera\.txt: camera model 'FOV'"):
        read_rgbd_folder(tmp_path)
