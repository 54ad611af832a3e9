# SPDX-License-Identifier: Apache-2.0
"""The demonstration: the main job on real photos, with a known answer and no download."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Mapping

import numpy as np
from tqdm import tqdm

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.demo.motorcycle import Motorcycle, load_motorcycle
from gscpe.demo.pictures import ARROW_SCALE, shift_picture, shifts
from gscpe.errors import GscpeError, OutputError
from gscpe.geometry.pose_error import PoseDifference, pose_difference
from gscpe.localization import LocalizationResult, Localizer
from gscpe.mapping import RgbdMapSettings, map_from_rgbd
from gscpe.matching import make_matcher
from gscpe.photos import to_uint8, write_image
from gscpe.render import choose_backend
from gscpe.render.pictures import Panel, difference_picture, montage


@dataclass(frozen=True, eq=False)
class DemoReport:
    """What the demonstration found.

    Attributes:
        renderer: what rendered.
        gaussians: in the map that was built.
        true_cam_from_world: (4, 4).
        result: of localizing the right photo.
        coarse_error, aligned_error, final_error: metres and degrees from the true pose.
        seconds: wall time by stage, building the map included.
        pictures: what was written, by name.
    """

    renderer: str
    gaussians: int
    true_cam_from_world: Float64Array
    result: LocalizationResult
    coarse_error: PoseDifference
    aligned_error: PoseDifference
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
            assert coarse.cam_from_world is not None and aligned.cam_from_world is not None
            assert result.cam_from_world is not None
            bar.update()

            bar.set_description_str("drawing pictures")
            truth = pair.right_from_left
            errors = {
                "coarse": pose_difference(coarse.cam_from_world, truth),
                "aligned": pose_difference(aligned.cam_from_world, truth),
                "final": pose_difference(result.cam_from_world, truth),
            }
            pictures = _write_pictures(localizer, pair, result, errors, Path(output))
            bar.update()
        bar.set_description_str("done")
    return DemoReport(
        renderer=localizer.renderer_description,
        gaussians=len(map_.scene),
        true_cam_from_world=truth,
        result=result,
        coarse_error=errors["coarse"],
        aligned_error=errors["aligned"],
        final_error=errors["final"],
        seconds=seconds | result.seconds,
        pictures=pictures,
    )


def _write_pictures(
    localizer: Localizer,
    pair: Motorcycle,
    result: LocalizationResult,
    errors: Mapping[str, PoseDifference],
    folder: Path,
) -> dict[str, Path]:
    assert result.coarse is not None and result.aligned is not None
    coarse, final = result.coarse.cam_from_world, result.cam_from_world
    assert coarse is not None and final is not None
    gain, bias = result.aligned.gain, result.aligned.bias
    truth = localizer.render(pair.right_camera, pair.right_from_left)
    pictures = {"photo": ("photo", pair.right)}
    median_shift = {}
    # The left photo's pose is the world's origin: there the search began.
    for stage, pose in (("start", np.eye(4)), ("coarse", coarse), ("final", final)):
        view = localizer.render(pair.right_camera, pose)
        difference = difference_picture(pair.right, view, gain, bias)
        pictures[f"render at the {stage} pose"] = (f"render_{stage}", to_uint8(view.rgb))
        pictures[f"difference at the {stage} pose (x4)"] = (f"difference_{stage}", difference)
        if stage != "start":
            arrows = shift_picture(pair.right, truth, pose)
            pictures[f"shift at the {stage} pose (x{ARROW_SCALE})"] = (f"shift_{stage}", arrows)
            _, moved, known = shifts(truth, pose)
            median_shift[stage] = float(np.median(np.linalg.norm(moved[known], axis=1)))
    drawn = {file: picture for file, picture in pictures.values()}
    begun = f"{100 * np.linalg.norm(pair.right_from_left[:3, 3]):.1f} cm off"
    pictures["overview"] = ("overview", _overview(drawn, errors, median_shift, begun))
    paths = {}
    for name, (file, picture) in pictures.items():
        paths[name] = (folder / f"{file}.png").resolve()
        write_image(paths[name], picture)
    return paths


def _overview(
    drawn: Mapping[str, UInt8Array],
    errors: Mapping[str, PoseDifference],
    median_shift: Mapping[str, float],
    begun: str,
) -> UInt8Array:
    """All of it in one picture; ``begun``: how far off the start was, for its caption."""

    def off(stage: str) -> str:
        return f"{1000 * errors[stage].distance:.2f} mm, {errors[stage].degrees:.3f} deg off"

    def shift_panel(stage: str) -> Panel:
        caption = (
            f"median shift {median_shift[stage]:.2f} px; arrows, {ARROW_SCALE} times as long:\n"
            "from where a point belongs to where this pose puts it"
        )
        return f"{stage} pose: {off(stage)}", drawn[f"shift_{stage}"], caption

    unseen = "not in the map, which the left photo and its depth made"
    return montage(
        [
            [
                ("the right photo, whose pose is sought", drawn["photo"], ""),
                ("the map, rendered at the final pose", drawn["render_final"], f"black: {unseen}"),
            ],
            [shift_panel("coarse"), shift_panel("final")],
            [
                (
                    f"|photo - render| x4 at the start: the left photo's pose, {begun}",
                    drawn["difference_start"],
                    f"dark blue: {unseen}",
                ),
                (
                    "|photo - render| x4 at the final pose",
                    drawn["difference_final"],
                    f"dark is good; dark blue: {unseen}",
                ),
            ],
        ]
    )
