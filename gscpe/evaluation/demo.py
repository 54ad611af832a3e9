"""The demonstration: the main job on real photos, with a known answer and no download."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array
from gscpe.errors import GscpeError, OutputError
from gscpe.evaluation.motorcycle import Motorcycle, load_motorcycle
from gscpe.evaluation.pictures import difference_picture, montage
from gscpe.geometry.pose_error import PoseDifference, pose_difference
from gscpe.localization import LocalizationResult, Localizer
from gscpe.mapping import RgbdMapSettings, map_from_rgbd
from gscpe.matching import make_matcher
from gscpe.render import choose_backend
from gscpe.scene import to_uint8, write_image


@dataclass(frozen=True, eq=False)
class DemoReport:
    """What the demonstration found.

    Attributes:
        renderer: what rendered.
        gaussians: in the map that was built.
        true_cam_from_world: (4, 4).
        result: of localizing the right photo.
        coarse_error, final_error: metres and degrees from the true pose.
        seconds: wall time by stage, building the map included.
        pictures: what was written, by name.
    """

    renderer: str
    gaussians: int
    true_cam_from_world: Float64Array
    result: LocalizationResult
    coarse_error: PoseDifference
    final_error: PoseDifference
    seconds: dict[str, float]
    pictures: dict[str, Path]


def run_demo(
    output: str | Path, backend: str = "auto", progress: bool = False, matcher: str = "auto"
) -> DemoReport:
    """Maps the left Motorcycle photo with its true depth, localizes the right one in the map
    from the left one's pose, and writes pictures.

    Raises:
        RenderError: OpenGL is missing.
        SettingsError, ModelError: as :func:`gscpe.matching.make_matcher`.
        OutputError: the pictures cannot be written.
        GscpeError: the photo was not localized.
    """
    try:
        Path(output).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{output} cannot be written: {error.strerror}") from error
    with tqdm(
        total=4, disable=not (progress and sys.stderr), bar_format="{desc:<28}{bar}{elapsed}"
    ) as bar:
        bar.set_description_str("loading the photos")
        backend, chosen = choose_backend(backend), make_matcher(matcher)
        pair = load_motorcycle()
        bar.update()

        bar.set_description_str("building the map")
        begin = time.perf_counter()
        map_ = map_from_rgbd(
            pair.left,
            pair.left_depth,
            pair.left_camera,
            np.eye(4),
            "motorcycle-left",
            RgbdMapSettings(backend=backend),
        )
        seconds = {"build map": time.perf_counter() - begin}
        bar.update()

        bar.set_description_str("localizing the right photo")
        with Localizer(map_, matcher=chosen, backend=backend) as localizer:
            result = localizer.localize(pair.right, pair.right_camera)
            coarse, aligned = result.coarse, result.aligned
            if not result.localized or coarse is None or aligned is None:
                raise GscpeError(f"the demo photo was not localized: {result.reason}")
            assert coarse.cam_from_world is not None and result.cam_from_world is not None
            bar.update()

            bar.set_description_str("drawing pictures")
            pictures = _write_pictures(localizer, pair, result, Path(output))
            bar.update()
        bar.set_description_str("done")
    truth = pair.right_from_left
    return DemoReport(
        renderer=localizer.renderer_description,
        gaussians=len(map_.scene),
        true_cam_from_world=truth,
        result=result,
        coarse_error=pose_difference(coarse.cam_from_world, truth),
        final_error=pose_difference(result.cam_from_world, truth),
        seconds=seconds | result.seconds,
        pictures=pictures,
    )


def _write_pictures(
    localizer: Localizer, pair: Motorcycle, result: LocalizationResult, folder: Path
) -> dict[str, Path]:
    assert result.coarse is not None and result.aligned is not None
    pictures = {"photo": pair.right}
    poses = {"coarse": result.coarse.cam_from_world, "final": result.cam_from_world}
    for stage, cam_from_world in poses.items():
        assert cam_from_world is not None
        view = localizer.render(pair.right_camera, cam_from_world)
        pictures[f"render at the {stage} pose"] = to_uint8(view.rgb)
        pictures[f"difference at the {stage} pose (x4)"] = difference_picture(
            pair.right, view, result.aligned.gain, result.aligned.bias
        )
    names = list(pictures)
    photo, _, coarse_difference, final, final_difference = names
    pictures["overview"] = montage(
        [
            [(photo, pictures[photo]), (final, pictures[final])],
            [
                (coarse_difference, pictures[coarse_difference]),
                (final_difference, pictures[final_difference]),
            ],
        ]
    )
    files = ("photo", "render_coarse", "difference_coarse", "render_final", "difference_final")
    paths = {}
    for file, (name, picture) in zip((*files, "overview"), pictures.items(), strict=True):
        paths[name] = (folder / f"{file}.png").resolve()
        write_image(paths[name], picture)
    return paths
