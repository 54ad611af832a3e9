# SPDX-License-Identifier: Apache-2.0
"""A run from above: references, true poses, and what was estimated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, Mapping, Sequence

import numpy as np
from markupsafe import Markup

from gscpe.arrays import Float64Array
from gscpe.evaluation import SceneRun
from gscpe.evaluation.text import degrees_text, length_text
from gscpe.geometry.pose_error import PoseDifference, camera_centres
from gscpe.geometry.spread import thinned
from gscpe.report.ground import choose_ground_plane
from gscpe.report.seen_from_above import (
    Frame,
    camera_layer,
    density_layer,
    drawing_of,
    frame_around,
    scale_bar,
)
from gscpe.report.settings import ReportSettings
from gscpe.report.svg import element, round_down
from gscpe.scene import Map

_ERROR_LENGTH = 0.06
"""Of the picture's width: how long the 90% quantile of the errors is drawn."""


@dataclass(frozen=True)
class TopView:
    """A drawing from above.

    Attributes:
        drawing: an ``svg`` element; empty where there are no cameras.
        legend: a text a kind of camera.
        caption: how the drawing is to be read.
    """

    drawing: Markup
    legend: Mapping[str, str]
    caption: str


def top_view(
    run: SceneRun, map_: Map, settings: ReportSettings, links: Mapping[str, str]
) -> TopView:
    """References, true poses, and what was estimated.

    Args:
        run: with estimated and true poses.
        map_: references and Gaussians.
        settings: how many cameras are drawn at most.
        links: addresses of photos within the page, by name.
    """
    references = thinned(list(map_.references.cam_from_world), settings.marks)
    truth, final, coarse = run.truth, run.poses("final"), run.poses("coarse")
    names = [str(detail["name"]) for detail in run.details]
    drawn = thinned([n for n in names if n in truth or n in final], settings.marks)
    poses = references + [(truth if n in truth else final)[n] for n in drawn]
    if not poses:
        return TopView(Markup(""), {}, "There are no cameras to draw.")
    centres = camera_centres(poses)
    all_references = map_.references.cam_from_world
    plane = choose_ground_plane(all_references.reshape(-1, 4, 4), centres)
    frame = frame_around(plane.flat(centres), plane.flat(map_.scene.means.astype(np.float64)))

    def at(poses: Sequence[Float64Array]) -> Float64Array:
        return frame.at(plane.flat(camera_centres(poses)))

    def looking(poses: Sequence[Float64Array]) -> Float64Array:
        ahead = plane.flat(np.array([pose[2, :3] for pose in poses]))
        return ahead * (1.0, -1.0)

    ceiling = float(np.max(centres @ plane.up))
    layers = [density_layer(map_, plane, frame, ceiling)]
    if references:
        layers.append(camera_layer(at(references), looking(references), "reference"))
    known = [n for n in drawn if n in truth]
    metric = run.metres_per_unit is not None
    errors = {"coarse": run.errors("coarse"), "final": run.errors("final")}
    factor = _exaggeration(errors["final"].values(), frame, run.metres_per_unit or 1.0)
    if known:
        true = [truth[n] for n in known]
        layers.append(camera_layer(at(true), looking(true), "truth"))
    # The aligned poses would lie under the final ones, which are mostly theirs.
    for stage, estimated in (("coarse", coarse), ("final", final)):
        compared = [n for n in known if n in estimated]
        if compared:
            begin = at([truth[n] for n in compared])
            error = at([estimated[n] for n in compared]) - begin
            titles = [_title(n, stage, errors[stage][n], metric) for n in compared]
            layers.append(_errors(compared, titles, begin, factor * error, stage, links))
    unknown = [n for n in drawn if n not in truth]
    if unknown:
        alone = [final[n] for n in unknown]
        layers.append(camera_layer(at(alone), looking(alone), "final"))
    layers.append(scale_bar(frame, run.metres_per_unit))
    counts = (
        f"{len(references)} reference photo{'s' * (len(references) != 1)} and "
        f"{len(drawn)} {'query' if len(drawn) == 1 else 'queries'}"
    )
    drawing = drawing_of(layers, frame, f"The map from above with {counts}.")
    legend = _legend(bool(known), bool(unknown), bool(references))
    return TopView(drawing, legend, "".join(_caption(plane.why, counts, factor, bool(known))))


def _caption(why: str, counts: str, factor: float, known: bool) -> list[str]:
    sentences = [f"Seen from above: {counts}. {why} "]
    if known:
        sentences.append(
            f"Coarse and final positions stand at {factor:g} times their true error, seen from "
            "the true position; long ones are cut at the border. "
        )
    sentences.append(
        "Ticks are viewing directions. Below, in their colours: the Gaussians' centres, up to "
        "the height of the highest camera."
    )
    return sentences


def _exaggeration(errors: Iterable[PoseDifference], frame: Frame, unit: float) -> float:
    """1, 2, 5, 10, ...: errors become visible, and the large ones do not fill the picture."""
    distances = [error.distance / unit for error in errors]
    if not distances:
        return 1.0
    typical = max(float(np.quantile(distances, 0.9)), 1e-9)
    return max(1.0, round_down(_ERROR_LENGTH * (frame.high[0] - frame.low[0]) / typical))


def _errors(
    names: Sequence[str],
    titles: Sequence[str],
    begin: Float64Array,
    error: Float64Array,
    stage: str,
    links: Mapping[str, str],
) -> Markup:
    marks = []
    for name, title, (x, y), (dx, dy) in zip(names, titles, begin, error, strict=True):
        d = f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"
        mark = element(
            "g",
            element("title", title),
            element("path", d=d, class_="tick"),
            element("path", d=f"{d}h0", class_="hit"),
            element("path", d=f"M{x + dx:.1f} {y + dy:.1f}h0", class_="dot"),
        )
        marks.append(element("a", mark, href=links[name]) if name in links else mark)
    return element("g", *marks, class_=f"error {stage}")


def _title(name: str, stage: str, error: PoseDifference, metric: bool) -> str:
    return (
        f"{name}: {stage}, {length_text(error.distance, metric)} and "
        f"{degrees_text(error.degrees)} off"
    )


def _legend(known: bool, unknown: bool, references: bool) -> dict[str, str]:
    legend = {"reference": "reference photo"} if references else {}
    if known:
        legend |= {"truth": "true pose", "coarse": "coarse pose"}
    if known or unknown:
        legend["final"] = "final pose"
    return legend
