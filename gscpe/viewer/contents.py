# SPDX-License-Identifier: Apache-2.0
"""What is shown beside the splat: cameras, how sure they are, what was not localized, a walk."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Collection, Iterator, Mapping, Sequence, TypeVar

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import SettingsError
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centre, camera_centres
from gscpe.geometry.spread import thinned
from gscpe.poses.hloc import parse_pose
from gscpe.report.ground import choose_ground_plane
from gscpe.scene import Map, MapFrame, References
from gscpe.scene.map_frame import typical_depth
from gscpe.viewer.cameras import KINDS, Kind, ShownCamera
from gscpe.viewer.ellipsoids import Ellipsoid, centre_ellipsoid

_T = TypeVar("_T")

MOST_CAMERAS = 400
"""Of a kind: a browser draws each as an object of its own."""

_NO_CAMERA = Camera.pinhole(640, 480, fx=525.0, fy=525.0, cx=320.0, cy=240.0)
"""Stands in where neither details nor references know one; only a frustum's shape comes of it."""


@dataclass(frozen=True, eq=False)
class Findings:
    """What is known of photos and of a walk, in the world; all may be empty.

    Attributes:
        poses: final ``cam_from_world``, (4, 4), by photo.
        details: what ``gscpe localize`` wrote, by photo (docs/formats.md).
        truth: true ``cam_from_world`` by photo.
        trajectory: ``cam_from_world`` by time in seconds.
        lost: why frames of the trajectory have no pose, by their names.
        walking: the trajectory's camera; None: as that of the references.
    """

    poses: Mapping[str, Float64Array] = field(default_factory=dict)
    details: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    truth: Mapping[str, Float64Array] = field(default_factory=dict)
    trajectory: Mapping[float, Float64Array] = field(default_factory=dict)
    lost: Mapping[str, str] = field(default_factory=dict)
    walking: Camera | None = None


@dataclass(frozen=True)
class Refused:
    """A photo without a pose, and why it has none."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A camera's way.

    Attributes:
        times: (N,) seconds, ascending.
        cam_from_map: (N, 4, 4).
        camera: whose frustum is moved along it.
    """

    times: Float64Array
    cam_from_map: Float64Array
    camera: Camera

    @property
    def centres(self) -> Float64Array:
        """(N, 3) camera centres in the map."""
        return camera_centres(self.cam_from_map)

    def at(self, time: float) -> int:
        """Index of the pose nearest in time."""
        return int(np.argmin(np.abs(self.times - time)))


@dataclass(frozen=True, eq=False)
class Contents:
    """Everything that is shown beside the splat, in the map's frame.

    Attributes:
        cameras: in the order of KINDS.
        ellipsoids: of the final poses that have a covariance.
        refused: photos that were not localized.
        trajectory: or None.
        axes: (3, 3), rows: unit vectors across, along and up.
        frustum_depth: length at which frusta are drawn, map units.
        depth: typical depth of surfaces, map units.
        notes: what a reader must know, a sentence each.
    """

    cameras: tuple[ShownCamera, ...]
    ellipsoids: tuple[Ellipsoid, ...]
    refused: tuple[Refused, ...]
    trajectory: Trajectory | None
    axes: Float64Array
    frustum_depth: float
    depth: float
    notes: tuple[str, ...]

    @property
    def up(self) -> Float64Array:
        """(3,) unit vector."""
        return np.asarray(self.axes[2])

    def of_kind(self, kind: Kind) -> tuple[ShownCamera, ...]:
        """The cameras of a kind."""
        return tuple(camera for camera in self.cameras if camera.kind == kind)

    def best(self, name: str) -> ShownCamera | None:
        """Where a photo is seen from: its final pose, or else the best that there is; its
        reference's or true pose where no other is known."""
        found = {camera.kind: camera for camera in self.cameras if camera.name == name}
        order: tuple[Kind, ...] = ("final", "aligned", "coarse", "truth", "reference")
        return next((found[kind] for kind in order if kind in found), None)

    def centres(self) -> Float64Array:
        """(N, 3) of all cameras and of the trajectory, map units; N may be 0."""
        centres = [camera_centre(camera.cam_from_map) for camera in self.cameras]
        if self.trajectory is not None:
            centres += list(self.trajectory.centres)
        return np.array(centres).reshape(-1, 3)


def contents_of(
    map_: Map,
    findings: Findings | None = None,
    most_cameras: int = MOST_CAMERAS,
    like: Contents | None = None,
) -> Contents:
    """What is shown of a map and of what was found in it.

    Args:
        map_: whose references are shown.
        findings: in the world's frame; None: nothing but the map.
        most_cameras: that are shown of a kind; more are thinned evenly, and a note says so.
        like: what was shown of the same map before more was found. Its axes and sizes are kept,
            and photos are thinned so that, as more come, those that are shown change seldom.

    Raises:
        SettingsError: fewer than one camera is to be shown.
    """
    if most_cameras < 1:
        raise SettingsError("at least one camera of a kind must be shown")
    findings = findings or Findings()
    references = map_.references
    fallback = references.cameras[0] if len(references) else _NO_CAMERA
    chosen = thinned if like is None else _thinned_by_halves
    known = list(dict.fromkeys([*findings.details, *findings.poses, *findings.truth]))
    names = frozenset(chosen(known, most_cameras))
    shown = [
        ShownCamera("reference", references.names[i], references.cam_from_world[i], camera)
        for i, camera in thinned(list(enumerate(references.cameras)), most_cameras)
    ]
    notes = _notes(references, len(shown), len(names), len(known))
    shown += _shown_photos(findings, names, map_.frame, fallback)
    shown.sort(key=lambda camera: KINDS.index(camera.kind))
    contents = Contents(
        cameras=tuple(shown),
        ellipsoids=tuple(_ellipsoids(findings, shown, map_.frame)),
        refused=tuple(_refused(findings)),
        trajectory=_trajectory(findings, map_, fallback),
        axes=np.eye(3),
        frustum_depth=0.0,
        depth=0.0,
        notes=notes,
    )
    if like is not None:
        return replace(contents, axes=like.axes, frustum_depth=like.frustum_depth, depth=like.depth)
    depth, centres = typical_depth(map_.scene, references), contents.centres()
    return replace(
        contents,
        axes=_axes(contents, centres),
        frustum_depth=_frustum_depth(centres, depth),
        depth=depth,
    )


def _notes(references: References, drawn: int, photos: int, known: int) -> tuple[str, ...]:
    notes = []
    if drawn < len(references):
        notes.append(f"{drawn} of {references.count_text()} are drawn.")
    if references.virtual:
        notes.append("The references are renders of the splat; there are no photos of them.")
    if photos < known:
        notes.append(f"{photos} of {known} localized photos are drawn.")
    return tuple(notes)


def _shown_photos(
    findings: Findings, names: Collection[str], frame: MapFrame, fallback: Camera
) -> Iterator[ShownCamera]:
    for kind, name, cam_from_world, camera, trusted in _located(findings, fallback):
        if name in names:
            yield ShownCamera(kind, name, frame.cam_from_map(cam_from_world), camera, trusted)


def _ellipsoids(
    findings: Findings, shown: Sequence[ShownCamera], frame: MapFrame
) -> Iterator[Ellipsoid]:
    """Of the final poses that have a covariance."""
    final = {each.name: each.cam_from_map for each in shown if each.kind == "final"}
    for name, pose in final.items():
        covariance = findings.details.get(name, {}).get("covariance")
        if covariance is not None:
            known = np.array(covariance, dtype=np.float64)
            yield centre_ellipsoid(name, pose, known, frame.scale)


def _located(
    findings: Findings, fallback: Camera
) -> Iterator[tuple[Kind, str, Float64Array, Camera, bool]]:
    """Kind, name, ``cam_from_world``, camera, and whether it is trusted, of every pose."""

    def camera_of(name: str) -> Camera:
        text = findings.details.get(name, {}).get("camera")
        return Camera.parse(text) if isinstance(text, str) else fallback

    for name, pose in findings.truth.items():
        yield "truth", name, pose, camera_of(name), True
    for name, detail in findings.details.items():
        trusted = detail["status"] == "localized"
        stages: tuple[Kind, ...] = ("coarse", "aligned")
        for stage in stages:
            text = (detail[stage] or {}).get("cam_from_world")
            if text is not None:
                yield stage, name, parse_pose(text), camera_of(name), trusted
        if name not in findings.poses and detail["cam_from_world"] is not None:
            yield "final", name, parse_pose(detail["cam_from_world"]), camera_of(name), True
    for name, pose in findings.poses.items():
        yield "final", name, pose, camera_of(name), True


def _refused(findings: Findings) -> Iterator[Refused]:
    for name, detail in findings.details.items():
        if name not in findings.poses and detail["cam_from_world"] is None:
            yield Refused(name, str(detail["reason"] or detail["status"]))
    if findings.poses and not findings.details:
        for name in findings.truth:
            if name not in findings.poses:
                yield Refused(name, "not in the poses; the details say why")
    for name, reason in findings.lost.items():
        yield Refused(name, reason)


def _trajectory(findings: Findings, map_: Map, fallback: Camera) -> Trajectory | None:
    if not findings.trajectory:
        return None
    times = np.array(sorted(findings.trajectory), dtype=np.float64)
    poses = np.stack([findings.trajectory[time] for time in times])
    return Trajectory(times, map_.frame.cam_from_map(poses), findings.walking or fallback)


def _axes(contents: Contents, centres: Float64Array) -> Float64Array:
    """Across, along and up; of the references where there are some, else of all cameras."""
    upright = contents.of_kind("reference") or contents.cameras
    if not upright:
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    plane = choose_ground_plane(np.stack([c.cam_from_map for c in upright]), centres)
    return np.vstack([plane.axes, plane.up])


def _frustum_depth(centres: Float64Array, depth: float) -> float:
    """Frusta neither vanish nor hide each other: about as long as cameras stand apart."""
    low, high = 0.03 * depth, 0.2 * depth
    if len(centres) < 2:
        return high
    some = np.array(thinned(list(centres), MOST_CAMERAS))
    apart = np.linalg.norm(some[:, None] - some[None], axis=2)
    apart[apart < 0.2 * low] = np.inf  # the same photo, coarse and final
    nearest = apart.min(axis=1)
    known = nearest[np.isfinite(nearest)]
    return float(np.clip(np.median(known), low, high)) if len(known) else high


def _thinned_by_halves(items: Sequence[_T], most: int) -> list[_T]:
    """At most so many, every first, second, fourth, ...: mostly the same ones as more come."""
    step = 1
    while len(items) > most * step:
        step *= 2
    return list(items[::step])
