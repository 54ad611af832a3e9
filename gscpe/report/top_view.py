# SPDX-License-Identifier: Apache-2.0
"""All cameras from above: references, truth, and what was estimated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Iterable, Mapping, Sequence, TypeVar

import numpy as np
from markupsafe import Markup

from gscpe.arrays import Float64Array
from gscpe.evaluation import SceneRun
from gscpe.evaluation.text import degrees_text, length_text
from gscpe.geometry.pose_error import PoseDifference, camera_centre
from gscpe.report.encode import data_uri
from gscpe.report.ground import GroundPlane, choose_ground_plane, density_picture
from gscpe.report.settings import ReportSettings
from gscpe.report.svg import element, round_down
from gscpe.scene import Map
from gscpe.scene.map_frame import typical_depth

_T = TypeVar("_T")

_WIDTH = 960.0
_MARGIN = 0.08
_FARTHEST = 0.4
"""Times the extent of the cameras that the Gaussians may add on each side, ..."""

_LEAST = 0.2
"""... or times the extent of the Gaussians: cameras on one spot need something around them."""

_REACH = 1.5
"""Times the typical depth: what cameras look at is shown in a map on its own."""

_ERROR_LENGTH = 0.06
"""Of the picture's width: how long the 90% quantile of the errors is drawn."""

_TICK = 13.0
_QUALITY = 80


@dataclass(frozen=True, eq=False)
class _Frame:
    """From the plane, map units, to the picture, pixels, y downwards."""

    low: Float64Array
    high: Float64Array

    @property
    def scale(self) -> float:
        return float(_WIDTH / (self.high[0] - self.low[0]))

    @property
    def height(self) -> float:
        return float(self.scale * (self.high[1] - self.low[1]))

    def at(self, flat: Float64Array) -> Float64Array:
        """Pixels, (N, 2), of points in the plane, (N, 2)."""
        return np.asarray((flat - (self.low[0], self.high[1])) * (self.scale, -self.scale))


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
    references = _thinned(list(map_.references.cam_from_world), settings.marks)
    truth, final, coarse = run.truth, run.poses("final"), run.poses("coarse")
    names = [str(detail["name"]) for detail in run.details]
    drawn = _thinned([n for n in names if n in truth or n in final], settings.marks)
    poses = references + [(truth if n in truth else final)[n] for n in drawn]
    if not poses:
        return TopView(Markup(""), {}, "There are no cameras to draw.")
    centres = np.array([camera_centre(pose) for pose in poses])
    all_references = map_.references.cam_from_world
    plane = choose_ground_plane(all_references.reshape(-1, 4, 4), centres)
    frame = _frame(plane.flat(centres), plane.flat(map_.scene.means.astype(np.float64)))

    def at(poses: Sequence[Float64Array]) -> Float64Array:
        return frame.at(plane.flat(np.array([camera_centre(pose) for pose in poses])))

    def looking(poses: Sequence[Float64Array]) -> Float64Array:
        ahead = plane.flat(np.array([pose[2, :3] for pose in poses]))
        return ahead * (1.0, -1.0)

    ceiling = float(np.max(centres @ plane.up))
    layers = [_density(map_, plane, frame, ceiling)]
    if references:
        layers.append(_cameras(at(references), looking(references), "reference"))
    known = [n for n in drawn if n in truth]
    metric = run.metres_per_unit is not None
    errors = {"coarse": run.errors("coarse"), "final": run.errors("final")}
    factor = _exaggeration(errors["final"].values(), frame, run.metres_per_unit or 1.0)
    if known:
        true = [truth[n] for n in known]
        layers.append(_cameras(at(true), looking(true), "truth"))
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
        layers.append(_cameras(at(alone), looking(alone), "final"))
    layers.append(_scale_bar(frame, run.metres_per_unit))
    counts = (
        f"{len(references)} reference photo{'s' * (len(references) != 1)} and "
        f"{len(drawn)} {'query' if len(drawn) == 1 else 'queries'}"
    )
    drawing = _drawing(layers, frame, f"The map from above with {counts}.")
    legend = _legend(bool(known), bool(unknown), bool(references))
    return TopView(drawing, legend, "".join(_caption(plane.why, counts, factor, bool(known))))


def map_from_above(map_: Map, marks: int = 400) -> dict[str, Any]:
    """A map and its reference photos, for pages that add cameras of their own; plain data.

    Args:
        map_: references and Gaussians.
        marks: references that are drawn at most.

    Returns:
        ``drawing``: text of an ``svg`` element; ``width`` and ``height`` of its view box;
        ``pixel_from_world``: (2, 4), from homogeneous world points to its pixels;
        ``metres_per_unit``, or None; ``caption``.
    """
    poses = map_.references.cam_from_world.reshape(-1, 4, 4)
    means = map_.scene.means.astype(np.float64)
    some = means[:: max(1, len(means) // 1000)]
    centres = np.array([camera_centre(pose) for pose in poses]) if len(poses) else some
    plane = choose_ground_plane(poses, centres)
    reach = _REACH * typical_depth(map_.scene, map_.references)
    frame = _frame(plane.flat(centres), plane.flat(means), reach)
    ceiling = float(np.max(centres @ plane.up))
    layers = [_density(map_, plane, frame, ceiling)]
    drawn = _thinned(list(poses), marks)
    if drawn:
        at = frame.at(plane.flat(np.array([camera_centre(pose) for pose in drawn])))
        ahead = plane.flat(np.array([pose[2, :3] for pose in drawn])) * (1.0, -1.0)
        layers.append(_cameras(at, ahead, "reference"))
    if map_.metres_per_unit is not None:  # a map's frame is in metres then
        layers.append(_scale_bar(frame, 1.0))
    # x_map = scale * (x_world - origin)
    flat = map_.frame.scale * np.column_stack([plane.axes, -plane.axes @ map_.frame.origin])
    flat[:, 3] -= (frame.low[0], frame.high[1])
    return {
        "drawing": str(_drawing(layers, frame, f"The map with {len(poses)} reference photos.")),
        "width": _WIDTH,
        "height": frame.height,
        "pixel_from_world": (np.diag([frame.scale, -frame.scale]) @ flat).tolist(),
        "metres_per_unit": map_.metres_per_unit,
        "caption": plane.why,
    }


def _density(map_: Map, plane: GroundPlane, frame: _Frame, ceiling: float) -> Markup:
    picture = density_picture(map_.scene, plane, frame.low, frame.high, ceiling)
    return element(
        "image",
        href=data_uri(picture, _QUALITY),
        x=0, y=0, width=_WIDTH, height=frame.height,
        preserveAspectRatio="none",
        class_="density",
    )  # fmt: skip


def _drawing(layers: Sequence[Markup], frame: _Frame, label: str) -> Markup:
    return element(
        "svg",
        *layers,
        class_="plot above",
        viewBox=f"0 0 {_WIDTH:g} {frame.height:.1f}",
        role="img",
        aria_label=label,
    )


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


def _frame(cameras: Float64Array, gaussians: Float64Array, reach: float = 0.0) -> _Frame:
    """Holds all cameras, and most of the Gaussians where they do not lie too far away: beyond the
    reach, and more than in proportion to the cameras."""
    low, high = cameras.min(axis=0), cameras.max(axis=0)
    inner, outer = np.quantile(gaussians, [0.03, 0.97], axis=0)
    added = max(
        _FARTHEST * float(np.max(high - low)), _LEAST * float(np.max(outer - inner)), reach, 1e-3
    )
    low = np.minimum(low, np.maximum(inner, low - added))
    high = np.maximum(high, np.minimum(outer, high + added))
    margin = _MARGIN * float(np.max(high - low))
    low, high = low - margin, high + margin
    size, middle = high - low, (low + high) / 2
    # Neither a ribbon nor a tower.
    size = np.array([max(size[0], size[1] / 1.2), max(size[1], 0.4 * size[0])])
    return _Frame(middle - size / 2, middle + size / 2)


def _exaggeration(errors: Iterable[PoseDifference], frame: _Frame, unit: float) -> float:
    """1, 2, 5, 10, ...: errors become visible, and the large ones do not fill the picture."""
    distances = [error.distance / unit for error in errors]
    if not distances:
        return 1.0
    typical = max(float(np.quantile(distances, 0.9)), 1e-9)
    return max(1.0, round_down(_ERROR_LENGTH * (frame.high[0] - frame.low[0]) / typical))


def _cameras(at: Float64Array, looking: Float64Array, kind: str) -> Markup:
    """All cameras of a kind as two paths: many are drawn."""
    ticks = "".join(
        f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"
        for (x, y), (dx, dy) in zip(at, _TICK * looking, strict=True)
    )
    dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in at)
    return element(
        "g",
        element("path", d=ticks, class_="tick"),
        element("path", d=dots, class_="dot"),
        class_=kind,
    )


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


def _scale_bar(frame: _Frame, metres_per_unit: float | None) -> Markup:
    unit = metres_per_unit or 1.0
    length = round_down(0.2 * (frame.high[0] - frame.low[0]) * unit)
    text = f"{length:g} {'units' if metres_per_unit is None else 'm'}"
    x, y, width = 24.0, frame.height - 24.0, length / unit * frame.scale
    return element(
        "g",
        element("path", d=f"M{x:g} {y - 6:.1f}v6h{width:.1f}v-6", class_="bar"),
        element("text", text, x=x + width / 2, y=y - 8, text_anchor="middle", class_="halo"),
    )


def _legend(known: bool, unknown: bool, references: bool) -> dict[str, str]:
    legend = {"reference": "reference photo"} if references else {}
    if known:
        legend |= {"truth": "true pose", "coarse": "coarse pose"}
    if known or unknown:
        legend["final"] = "final pose"
    return legend


def _thinned(items: Sequence[_T], most: int) -> list[_T]:
    if len(items) <= most:
        return list(items)
    return [items[i] for i in np.rint(np.linspace(0, len(items) - 1, most)).astype(int)]
