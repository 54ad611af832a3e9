# SPDX-License-Identifier: Apache-2.0
"""What the page says: HTML of the legend, of the photo that is looked at, of what is missing."""

from __future__ import annotations

from html import escape
from typing import Collection, Iterable, Sequence

import numpy as np

from gscpe.geometry.pose_error import pose_difference
from gscpe.scene import MapFrame
from gscpe.viewer.cameras import COLOURS, KINDS, TITLES, TRAJECTORY, ShownCamera
from gscpe.viewer.contents import Contents, Refused
from gscpe.viewer.splat import BrowserSplat

_NO_POSE = "(not localized)"
_MOST_ROWS = 500
_STYLE = "padding: 0 0.8em; font-size: 0.85em; line-height: 1.5"


def readable(text: str) -> str:
    """Text that can be sent: names of files need not be text in any encoding."""
    return text.encode("utf-8", "replace").decode()


def name_options(names: Iterable[str], refused: Collection[str]) -> dict[str, str]:
    """Names of photos, by what a list shows."""
    return {
        f"{readable(name)} {_NO_POSE}" if name in refused else readable(name): name
        for name in names
    }


def _html(text: str) -> str:
    return escape(readable(text))


def summary_html(name: str, splat: BrowserSplat, contents: Contents) -> str:
    """What the map is, and what is left out."""
    sentences = [f"<b>{_html(name)}</b>: {splat.total:,} Gaussians."]
    if len(splat) < splat.total:
        sentences.append(
            f"The browser draws the {len(splat):,} that are most visible; poses are found with all."
        )
    sentences += [escape(note) for note in contents.notes]
    return f'<div style="{_STYLE}">{" ".join(sentences)}</div>'


def news_html(text: str) -> str:
    """What is going on."""
    return f'<div style="{_STYLE}"><b>{_html(text)}</b></div>'


def legend_html(contents: Contents) -> str:
    """The colours of the kinds of cameras that are there."""
    entries = [
        (COLOURS[kind], f"{TITLES[kind]} ({len(contents.of_kind(kind))})")
        for kind in KINDS
        if contents.of_kind(kind)
    ]
    if contents.trajectory is not None:
        entries.append((TRAJECTORY, "trajectory"))
    rows = "".join(
        f'<div><span style="display:inline-block;width:0.8em;height:0.8em;margin-right:0.6em;'
        f'background:rgb{colour}"></span>{escape(text)}</div>'
        for colour, text in entries
    )
    return f'<div style="{_STYLE}">{rows}</div>'


def photo_html(shown: ShownCamera, contents: Contents, frame: MapFrame, has_photo: bool) -> str:
    """What is known of the photo that is looked at."""
    sentences = [f"<b>{_html(shown.name)}</b>, {TITLES[shown.kind]}."]
    if not shown.trusted:
        reason = next((r.reason for r in contents.refused if r.name == shown.name), "")
        sentences.append(f"Not localized: {_html(reason)}.")
    others = {camera.kind: camera for camera in contents.cameras if camera.name == shown.name}
    if "truth" in others and shown.kind != "truth":
        error = pose_difference(shown.cam_from_map, others["truth"].cam_from_map)
        sentences.append(
            f"{frame.length_text(error.distance)} and {error.degrees:.3g}° from the true pose."
        )
    for ellipsoid in contents.ellipsoids:
        if ellipsoid.name == shown.name:
            deviation = frame.length_text(float(np.linalg.norm(ellipsoid.radii)))
            sentences.append(f"Standard deviation of the position: {deviation}.")
    if not has_photo:
        sentences.append("The photo itself is not there: say where with --images.")
    return f'<div style="{_STYLE}">{" ".join(sentences)}</div>'


def refused_html(refused: Sequence[Refused]) -> str:
    """Names and reasons."""
    rows = "".join(
        f"<div><b>{_html(each.name)}</b>: {_html(each.reason)}</div>"
        for each in refused[:_MOST_ROWS]
    )
    if len(refused) > _MOST_ROWS:
        rows += f"<div>and {len(refused) - _MOST_ROWS} more</div>"
    return f'<div style="{_STYLE}">{rows}</div>'
