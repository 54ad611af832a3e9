# SPDX-License-Identifier: Apache-2.0
"""The page in the browser: what :mod:`gscpe.viewer` computes, handed to viser."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any, Sequence

from gscpe.arrays import Float64Array, UInt8Array
from gscpe.closing import Closing
from gscpe.geometry import se3
from gscpe.geometry.pose_error import camera_centres
from gscpe.render import Renderer
from gscpe.scene import Map
from gscpe.viewer.camera_nodes import CameraNodes
from gscpe.viewer.cameras import KINDS, TITLES, Kind, ShownCamera, Viewpoint
from gscpe.viewer.contents import Contents
from gscpe.viewer.cut_splat import CutSplat
from gscpe.viewer.flight import Flight
from gscpe.viewer.opening import from_afar, opening
from gscpe.viewer.photo_controls import PhotoControls
from gscpe.viewer.photos import Photos
from gscpe.viewer.server import check_viser, page_url, start_server, stop_server
from gscpe.viewer.splat import MOST_GAUSSIANS, browser_splat, browser_unit
from gscpe.viewer.texts import legend_html, news_html, refused_html, summary_html
from gscpe.viewer.walk import Walk

if TYPE_CHECKING:
    import viser


class Viewer(Closing):
    """A map in the browser: close it to stop the server.

    Args:
        map_: that is shown.
        contents: what is shown beside it, see :func:`contents_of`.
        photo_folders: where photos are found by name; the first that has one counts.
        name: of the map, for the page.
        host, port: to listen at; port None: 8080, or the next that is free.
        most_gaussians: that are sent to the browser, the most visible.
        backend: of the renderer that photos are compared with.
        grows: whether :meth:`show` will be called: the trajectory's camera is at the newest pose.

    Attributes:
        contents: what is shown now.

    Raises:
        MissingDependencyError: viser is not installed.
        OutputError: the port is taken, or the address not of this machine.
        InputError: a photo folder is not there.
        RenderError: there is nothing to render with.
    """

    def __init__(
        self,
        map_: Map,
        contents: Contents,
        photo_folders: Sequence[str | Path] = (),
        *,
        name: str = "map",
        host: str = "127.0.0.1",
        port: int | None = None,
        most_gaussians: int = MOST_GAUSSIANS,
        backend: str = "auto",
        grows: bool = False,
    ) -> None:
        check_viser()
        self._frame, self._name, self.contents = map_.frame, name, contents
        photos = Photos(photo_folders)
        eyes = camera_centres(map_.references.cam_from_world)
        self._splat = browser_splat(map_.scene, most_gaussians, eyes)
        self._unit = browser_unit(self._splat)
        self._flight = Flight(self._unit, contents.depth)
        self._renderer = Renderer(map_.scene, backend)
        self._lock = threading.Lock()
        self._closed = threading.Event()
        try:
            begin = opening(contents, map_.scene, backend)
            self._server = start_server(host, port, "gscpe")
        except BaseException:
            self._renderer.close()
            raise
        self._host = host
        self._cut = CutSplat(self._server, self._splat, self._unit, contents.axes)
        self._nodes = CameraNodes(self._server, self._unit, photos, self._go)
        self._add_panel(photos, grows)
        self._look_from(begin, contents.up)
        self.show(contents)

    @property
    def url(self) -> str:
        """Where a browser finds the page."""
        return page_url(self._host, self._server.get_port())

    def show(self, contents: Contents, picture: UInt8Array | None = None) -> None:
        """Shows these contents in place of those before: what is new is drawn, and what is the
        same stays as it is.

        Args:
            contents: of the same map, with the axes and sizes of those before (``like``).
            picture: what the newest camera of the trajectory saw; None: as before.
        """
        with self._lock:
            if self._closed.is_set():
                return
            self.contents = contents
            self._nodes.show(contents)
            self._photos.show(contents, self._nodes)
            self._photos.afar = from_afar(contents)
            self._walk.show(contents.trajectory, contents.frustum_depth, picture)
            self._summary.content = summary_html(self._name, self._splat, contents)
            self._legend.content = legend_html(contents)
            for kind, box in self._boxes.items():
                box.visible = bool(contents.of_kind(kind))
            self._refused_folder.visible = bool(contents.refused)
            self._refused_folder.label = f"Not localized ({len(contents.refused)})"
            self._refused.content = refused_html(contents.refused)
            self._uncertainty.visible = bool(contents.ellipsoids)
            self._walk_folder.visible = contents.trajectory is not None

    def say(self, text: str) -> None:
        """Shows a sentence at the top of the panel, in place of the one before."""
        if not self._closed.is_set():
            self._news.content = news_html(text)
            self._news.visible = True

    def wait(self) -> None:
        """Until another thread closes the viewer, or Ctrl-C interrupts the program."""
        while not self._closed.wait(0.5):
            pass

    def close(self) -> None:
        """Stops the server and releases the map."""
        if not self._closed.is_set():
            self._closed.set()
            self._nodes.close()
            with self._lock:
                stop_server(self._server)
            self._renderer.close()

    def _go(self, client: viser.ClientHandle, shown: ShownCamera) -> None:
        self._photos.go(client, shown)

    def _look_from(self, begin: Viewpoint, up: Float64Array) -> None:
        """Where new browsers look from, and where a button leads back to."""
        self._photos.begin = begin
        camera = self._server.initial_camera
        turn = se3.from_quaternion_translation(begin.quaternion, [0, 0, 0])[:3, :3]
        reach = self._flight.depth * self._unit
        self._server.scene.set_up_direction(up)
        camera.position = self._unit * begin.position
        camera.look_at = self._unit * begin.position + reach * turn[:, 2]
        camera.up = up
        camera.fov = begin.vertical_angle
        camera.far = max(1000.0, 200.0 * reach)

    def _add_panel(self, photos: Photos, grows: bool) -> None:
        """All of it; what has nothing to show is hidden by :meth:`show`."""
        gui = self._server.gui
        self._summary: Any = gui.add_html("")
        self._news: Any = gui.add_html("", visible=False)
        with gui.add_folder("Cameras"):
            self._legend: Any = gui.add_html("")
            self._boxes = {kind: self._add_checkbox(kind) for kind in KINDS}
        with gui.add_folder("Photos"):
            self._photos = PhotoControls(
                self._server, self._flight, self._frame, photos, self._renderer
            )
        self._refused_folder: Any = gui.add_folder("Not localized")
        with self._refused_folder:
            self._refused: Any = gui.add_html("")
        self._uncertainty: Any = gui.add_folder("Uncertainty", expand_by_default=False)
        with self._uncertainty:
            sigmas = gui.add_slider("Standard deviations", 1, 200, 1, 3)
            sigmas.on_update(lambda _: self._nodes.enlarge(sigmas.value))
            self._nodes.enlarge(sigmas.value)
        self._walk_folder: Any = gui.add_folder("Trajectory")
        with self._walk_folder:
            self._walk = Walk(self._server, self._unit, self._flight, grows)
        with gui.add_folder("Section", expand_by_default=False):
            self._cut.add_sliders()

    def _add_checkbox(self, kind: Kind) -> Any:
        box = self._server.gui.add_checkbox(TITLES[kind], True)
        box.on_update(lambda _: self._nodes.show_kind(kind, box.value))
        return box
