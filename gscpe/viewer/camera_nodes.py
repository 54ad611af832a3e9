# SPDX-License-Identifier: Apache-2.0
"""Cameras in the browser: frusta with small photos, and ellipsoids of how sure they are."""

from __future__ import annotations

import math
import threading
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from gscpe.closing import Closing
from gscpe.geometry import se3
from gscpe.viewer.cameras import COLOURS, Kind, ShownCamera
from gscpe.viewer.contents import Contents
from gscpe.viewer.ellipsoids import Ellipsoid, sphere_mesh
from gscpe.viewer.photos import Photos

if TYPE_CHECKING:
    import viser

    Clicked = Callable[[viser.ClientHandle, ShownCamera], None]

_THUMBNAIL = 160  # pixels
_WITH_PHOTO: tuple[Kind, ...] = ("reference", "final")


class CameraNodes(Closing):
    """The cameras of what is shown; see :meth:`show`.

    Args:
        server: of the page.
        unit: browser units in a map unit.
        photos: behind the cameras.
        clicked: is told who clicked on a frustum, and on which.
    """

    def __init__(
        self, server: viser.ViserServer, unit: float, photos: Photos, clicked: Clicked
    ) -> None:
        self._server, self._unit, self._photos, self._clicked = server, unit, photos, clicked
        self._all = server.scene.add_frame("/cameras", show_axes=False)
        self._frusta: dict[tuple[Kind, str], tuple[ShownCamera, Any]] = {}
        self._hidden: set[Kind] = set()
        self._drawn = 0
        self._ellipsoids: tuple[Ellipsoid, ...] = ()
        self._mesh: Any = None
        self._sigmas = 1.0
        self._wanted: SimpleQueue[tuple[ShownCamera, Any] | None] = SimpleQueue()
        self._closed = threading.Event()
        self._lock = threading.RLock()  # nodes that were removed must not be written to
        threading.Thread(target=self._add_thumbnails, daemon=True).start()

    def show(self, contents: Contents) -> None:
        """Draws what is new and removes what is not there any more; the rest stays as it is."""
        wanted = {(shown.kind, shown.name): shown for shown in contents.cameras}
        with self._lock:
            for key, (shown, node) in list(self._frusta.items()):
                new = wanted.get(key)
                if new is None or not np.array_equal(new.cam_from_map, shown.cam_from_map):
                    del self._frusta[key]
                    node.remove()
            for key, shown in wanted.items():
                if key not in self._frusta:
                    self._draw(key, shown, contents.frustum_depth)
            if _differ(contents.ellipsoids, self._ellipsoids):
                self._ellipsoids = contents.ellipsoids
                self._draw_ellipsoids()

    def frusta(self) -> list[tuple[ShownCamera, Any]]:
        """Cameras and their nodes."""
        return list(self._frusta.values())

    def show_kind(self, kind: Kind, visible: bool) -> None:
        """Whether cameras of a kind are seen; also those that come later."""
        with self._lock:
            (self._hidden.discard if visible else self._hidden.add)(kind)
            for shown, node in self.frusta():
                if shown.kind == kind:
                    node.visible = visible

    def show_photo(self, name: str, visible: bool) -> None:
        """Whether the cameras of one photo are seen."""
        with self._lock:
            for shown, node in self.frusta():
                if shown.name == name:
                    node.visible = visible and shown.kind not in self._hidden

    def show_all(self, visible: bool) -> None:
        """Whether anything of this is seen."""
        with self._lock:
            self._all.visible = visible
            if self._mesh is not None:
                self._mesh.visible = visible

    def enlarge(self, sigmas: float) -> None:
        """Standard deviations at which ellipsoids are drawn."""
        with self._lock:
            self._sigmas = sigmas
            if self._mesh is not None:
                self._mesh.batched_scales = self._radii()

    def close(self) -> None:
        """No more photos are read."""
        self._closed.set()
        self._wanted.put(None)

    def _draw(self, key: tuple[Kind, str], shown: ShownCamera, depth: float) -> None:
        self._drawn += 1
        name = f"/cameras/{shown.kind}/{self._drawn}"
        node = add_frustum(
            self._server, name, shown, COLOURS[shown.kind], self._unit, depth * self._unit
        )
        node.visible = shown.kind not in self._hidden
        node.on_click(lambda event: self._clicked(event.client, shown))
        self._frusta[key] = shown, node
        if shown.kind in _WITH_PHOTO:
            self._wanted.put((shown, node))

    def _add_thumbnails(self) -> None:
        """Meanwhile: a thousand photos take a while to read."""
        while (wanted := self._wanted.get()) is not None and not self._closed.is_set():
            shown, node = wanted
            picture = self._photos.picture(shown, _THUMBNAIL)
            with self._lock:
                there = self._frusta.get((shown.kind, shown.name))
                if picture is not None and there is not None and there[1] is node:
                    node.image = picture

    def _draw_ellipsoids(self) -> None:
        ellipsoids = self._ellipsoids
        if self._mesh is not None:
            self._mesh.remove()
            self._mesh = None
        if not ellipsoids:
            return
        corners, triangles = sphere_mesh()
        self._mesh = self._server.scene.add_batched_meshes_simple(
            "/ellipsoids",
            corners.astype(np.float32),
            triangles.astype(np.uint32),
            batched_wxyzs=np.array([each.quaternion for each in ellipsoids]),
            batched_positions=self._unit * np.array([each.centre for each in ellipsoids]),
            batched_scales=self._radii(),
            batched_colors=COLOURS["final"],
            opacity=0.5,
            lod="off",
            visible=bool(self._all.visible),
        )

    def _radii(self) -> Any:
        radii = np.array([each.radii for each in self._ellipsoids])
        return (self._sigmas * self._unit * radii).astype(np.float32)


def add_frustum(
    server: viser.ViserServer,
    name: str,
    shown: ShownCamera,
    colour: tuple[int, int, int],
    unit: float,
    depth: float,
) -> Any:
    """A camera's frustum.

    Args:
        server: of the page.
        name: of the node.
        shown: the camera.
        colour: RGB.
        unit: browser units in a map unit.
        depth: its length, browser units.
    """
    pinhole = shown.camera.without_distortion()
    half_height = pinhole.height / pinhole.fy / 2
    half_width = pinhole.width / pinhole.fx / 2
    quaternion, position = se3.to_quaternion_translation(se3.inverse(shown.cam_from_map))
    return server.scene.add_camera_frustum(
        name,
        fov=2.0 * math.atan(half_height),
        aspect=half_width / half_height,
        # viser draws frusta of the same volume, whatever their angles.
        scale=depth * float(np.cbrt(half_width * half_height / 3.0)),
        thickness=1.5,
        thickness_units="screen",
        color=colour,
        wxyz=quaternion,
        position=unit * position,
    )


def _differ(new: tuple[Ellipsoid, ...], old: tuple[Ellipsoid, ...]) -> bool:
    return len(new) != len(old) or any(
        not np.array_equal(a.centre, b.centre) or not np.array_equal(a.radii, b.radii)
        for a, b in zip(new, old, strict=True)
    )
