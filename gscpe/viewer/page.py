# SPDX-License-Identifier: Apache-2.0
"""The page in the browser: what :mod:`gscpe.viewer` computes, handed to viser."""

from __future__ import annotations

import math
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any, Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.closing import Closing
from gscpe.geometry import se3
from gscpe.geometry.camera import Camera
from gscpe.render import Renderer
from gscpe.scene import Map
from gscpe.viewer.cameras import (
    COLOURS,
    TITLES,
    TRAJECTORY,
    Kind,
    ShownCamera,
    Viewpoint,
    photo_plane,
    viewpoint_of,
)
from gscpe.viewer.contents import Contents, Trajectory
from gscpe.viewer.ellipsoids import sphere_mesh
from gscpe.viewer.flight import Flight
from gscpe.viewer.overview import overview_pose
from gscpe.viewer.photo_over_map import PhotoOverMap, photo_over_map
from gscpe.viewer.photos import Photos
from gscpe.viewer.server import check_viser, start_server, stop_server
from gscpe.viewer.splat import (
    MOST_GAUSSIANS,
    Section,
    browser_splat,
    browser_unit,
    scaled_covariances,
)
from gscpe.viewer.texts import legend_html, photo_html, refused_html, summary_html

if TYPE_CHECKING:
    import viser

_NONE = "\N{EM DASH}"
_NO_MATCH = "(not localized)"
_THUMBNAIL = 160  # pixels
_SIDES = ("Across", "Along", "Height")
_ANGLE = math.radians(50.0)


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
    ) -> None:
        check_viser()
        self._map, self._contents = map_, contents
        self._photos = Photos(photo_folders)
        self._splat = browser_splat(map_.scene, most_gaussians)
        self._unit = browser_unit(self._splat)
        self._flight = Flight(self._unit, contents.depth)
        self._renderer = Renderer(map_.scene, backend)
        self._lock = threading.RLock()
        self._comparison: PhotoOverMap | None = None
        self._chosen: ShownCamera | None = None
        self._overlay: Any = None
        self._frusta: dict[str, list[tuple[ShownCamera, Any]]] = {}
        self._closed = threading.Event()
        try:
            self._server = start_server(host, port, "gscpe")
        except BaseException:
            self._renderer.close()
            raise
        self._address = f"http://{host if host != '0.0.0.0' else 'localhost'}"
        self._show_splat()
        self._show_cameras()
        self._show_ellipsoids()
        self._look_from_afar()
        self._add_panel(name)
        threading.Thread(target=self._add_thumbnails, daemon=True).start()

    @property
    def url(self) -> str:
        """Where a browser finds the page."""
        return f"{self._address}:{self._server.get_port()}"

    def wait(self) -> None:
        """Until another thread closes the viewer, or Ctrl-C interrupts the program."""
        while not self._closed.wait(0.5):
            pass

    def close(self) -> None:
        """Stops the server and releases the map."""
        if not self._closed.is_set():
            self._closed.set()
            stop_server(self._server)
            self._renderer.close()

    # What is in the scene

    def _show_splat(self) -> None:
        splat = self._splat
        self._splat_node = self._server.scene.add_gaussian_splats(
            "/splat",
            centers=splat.means * np.float32(self._unit),
            covariances=scaled_covariances(splat, self._unit),
            rgbs=splat.colours,
            opacities=splat.opacities,
        )
        self._buffer = self._splat_node.buffer
        self._section = Section.around(splat.means, self._contents.axes)

    def _show_cameras(self) -> None:
        self._all_cameras = self._server.scene.add_frame("/cameras", show_axes=False)
        for index, shown in enumerate(self._contents.cameras):
            node = self._add_frustum(_node(shown.kind, index), shown, COLOURS[shown.kind])
            self._frusta.setdefault(shown.name, []).append((shown, node))
            node.on_click(lambda event, shown=shown: self._go(event.client, shown))

    def _add_frustum(
        self, name: str, shown: ShownCamera, colour: tuple[int, int, int], size: float = 1.0
    ) -> Any:
        pinhole = shown.camera.without_distortion()
        half_height = pinhole.height / pinhole.fy / 2
        half_width = pinhole.width / pinhole.fx / 2
        quaternion, position = se3.to_quaternion_translation(se3.inverse(shown.cam_from_map))
        # viser draws frusta of the same volume, whatever their angles.
        depth = size * self._contents.frustum_depth * self._unit
        return self._server.scene.add_camera_frustum(
            name,
            fov=2.0 * math.atan(half_height),
            aspect=half_width / half_height,
            scale=depth * float(np.cbrt(half_width * half_height / 3.0)),
            thickness=1.5,
            thickness_units="screen",
            color=colour,
            wxyz=quaternion,
            position=self._unit * position,
        )

    def _show_ellipsoids(self) -> None:
        ellipsoids = self._contents.ellipsoids
        self._ellipsoids: Any = None
        if ellipsoids:
            corners, triangles = sphere_mesh()
            self._radii = self._unit * np.array([each.radii for each in ellipsoids])
            self._ellipsoids = self._server.scene.add_batched_meshes_simple(
                "/ellipsoids",
                corners.astype(np.float32),
                triangles.astype(np.uint32),
                batched_wxyzs=np.array([each.quaternion for each in ellipsoids]),
                batched_positions=self._unit * np.array([each.centre for each in ellipsoids]),
                batched_scales=self._radii,
                batched_colors=COLOURS["final"],
                opacity=0.5,
                lod="off",
            )

    def _add_thumbnails(self) -> None:
        """Meanwhile: a thousand photos take a while to read."""
        for cameras in self._frusta.values():
            for shown, node in cameras:
                if shown.kind not in ("reference", "final") or self._closed.is_set():
                    continue
                picture = self._photos.picture(shown, _THUMBNAIL)
                if picture is not None:
                    node.image = picture

    def _look_from_afar(self) -> None:
        point = self._overview()
        camera = self._server.initial_camera
        turn = se3.from_quaternion_translation(point.quaternion, [0, 0, 0])[:3, :3]
        reach = self._contents.depth * self._unit
        self._server.scene.set_up_direction(self._contents.up)
        camera.position = self._unit * point.position
        camera.look_at = self._unit * point.position + reach * turn[:, 2]
        camera.up = self._contents.up
        camera.fov = point.vertical_angle
        camera.far = max(1000.0, 200.0 * reach)

    def _overview(self) -> Viewpoint:
        pinhole = Camera.pinhole(160, 100, fx=107.0, fy=107.0, cx=80.0, cy=50.0)
        pose, _ = overview_pose(self._contents, pinhole)
        quaternion, position = se3.to_quaternion_translation(se3.inverse(pose))
        return Viewpoint(position, quaternion, _ANGLE)

    # The panel

    def _add_panel(self, name: str) -> None:
        gui, contents = self._server.gui, self._contents
        gui.add_html(summary_html(name, self._splat, contents))
        with gui.add_folder("Cameras"):
            gui.add_html(legend_html(contents))
            for kind in dict.fromkeys(camera.kind for camera in contents.cameras):
                self._add_checkbox(kind)
        with gui.add_folder("Photos"):
            self._add_photo_controls()
        if contents.refused:
            with gui.add_folder(f"Not localized ({len(contents.refused)})"):
                gui.add_html(refused_html(contents.refused))
        if contents.ellipsoids:
            with gui.add_folder("Uncertainty", expand_by_default=False):
                self._add_sigma_slider()
        if contents.trajectory is not None:
            with gui.add_folder("Trajectory"):
                self._add_trajectory(contents.trajectory)
        with gui.add_folder("Section", expand_by_default=False):
            self._add_section_sliders()

    def _add_checkbox(self, kind: Kind) -> None:
        box = self._server.gui.add_checkbox(TITLES[kind], True)

        @box.on_update
        def _(_: Any) -> None:
            for shown, node in self._all_frusta():
                if shown.kind == kind:
                    node.visible = box.value

    def _all_frusta(self) -> list[tuple[ShownCamera, Any]]:
        return [pair for pairs in self._frusta.values() for pair in pairs]

    def _add_photo_controls(self) -> None:
        gui, contents = self._server.gui, self._contents
        refused = {each.name for each in contents.refused}
        queries = dict.fromkeys(c.name for c in contents.cameras if c.kind != "reference")
        names = {f"{n} {_NO_MATCH}" if n in refused else n: n for n in queries}
        references = [camera.name for camera in contents.of_kind("reference")]
        for label, options in (("Photo", names), ("Reference", {n: n for n in references})):
            if options:
                self._add_dropdown(label, options, label == "Reference")
        self._blend = gui.add_slider("Photo over map", 0.0, 1.0, 0.01, 0.5)
        self._blend.on_update(lambda _: self._draw_overlay())
        self._difference = gui.add_checkbox("Difference, 4 times", False)
        self._difference.on_update(lambda _: self._draw_overlay())
        self._about = gui.add_html("")
        back = gui.add_button("Back to the overview")
        back.on_click(lambda event: self._leave(event.client))

    def _add_dropdown(self, label: str, options: dict[str, str], reference: bool) -> None:
        dropdown = self._server.gui.add_dropdown(label, (_NONE, *options))

        @dropdown.on_update
        def _(event: Any) -> None:
            if event.client is None or dropdown.value == _NONE:
                return
            name = options[dropdown.value]
            cameras = self._contents.of_kind("reference") if reference else ()
            shown = next((c for c in cameras if c.name == name), self._contents.best(name))
            if shown is not None:
                self._go(event.client, shown)

    def _add_sigma_slider(self) -> None:
        slider = self._server.gui.add_slider("Standard deviations", 1, 200, 1, 3)

        def update(_: Any = None) -> None:
            self._ellipsoids.batched_scales = (slider.value * self._radii).astype(np.float32)

        slider.on_update(update)
        update()

    def _add_trajectory(self, trajectory: Trajectory) -> None:
        gui, scene, unit = self._server.gui, self._server.scene, self._unit
        centres = (unit * trajectory.centres).astype(np.float32)
        if len(centres) > 1:
            lines = np.stack([centres[:-1], centres[1:]], axis=1)
            scene.add_line_segments(
                "/trajectory", lines, TRAJECTORY, thickness=2.0, thickness_units="screen"
            )
        first, last = float(trajectory.times[0]), float(trajectory.times[-1])
        now = self._add_frustum("/now", _at(trajectory, 0), TRAJECTORY, 1.5)
        if last == first:
            return
        span = last - first
        slider = gui.add_slider("Seconds", 0.0, span, span / 1000.0, 0.0)
        ride = gui.add_checkbox("Ride along", False)

        @slider.on_update
        def _(event: Any) -> None:
            shown = _at(trajectory, trajectory.at(first + slider.value))
            quaternion, position = se3.to_quaternion_translation(se3.inverse(shown.cam_from_map))
            with self._server.atomic():
                now.wxyz, now.position = quaternion, unit * position
            now.visible = not ride.value
            if ride.value and event.client is not None:
                self._flight.put(event.client, viewpoint_of(shown, event.client.camera.aspect))

    def _add_section_sliders(self) -> None:
        low, high = self._section.limits
        self._sliders: list[Any] = []
        for name, begin, end in zip(_SIDES, low.tolist(), high.tolist(), strict=True):
            step = (end - begin) / 200.0
            slider = self._server.gui.add_multi_slider(name, begin, end, step, (begin, end))
            slider.on_update(lambda _: self._cut())
            self._sliders.append(slider)

    def _cut(self) -> None:
        with self._lock:  # of many events while dragging, the last one counts
            old = self._section
            ends = np.array([slider.value for slider in self._sliders])
            if np.array_equal(ends.T, [old.low, old.high]):
                return
            self._section = Section(old.axes, ends[:, 0], ends[:, 1], old.limits)
            inside = self._section.inside(self._splat.means)
            if not np.any(inside):
                inside[:1] = True  # viser needs one
            self._splat_node.buffer = self._buffer[inside]

    # Flying

    def _go(self, client: viser.ClientHandle, shown: ShownCamera) -> None:
        """Flies to a camera and lays its photo over the map."""
        with self._lock:
            self._remove_overlay()
            self._flight.fly(client, viewpoint_of(shown, client.camera.aspect))
            self._chosen = shown
            for _, node in self._frusta[shown.name]:
                node.visible = False  # it would lie before what it shows
            self._comparison = photo_over_map(shown, self._photos, self._renderer)
            self._about.content = photo_html(
                shown, self._contents, self._map.frame, self._comparison is not None
            )
            self._draw_overlay()

    def _leave(self, client: viser.ClientHandle | None) -> None:
        with self._lock:
            self._remove_overlay()
            if client is not None:
                self._flight.fly(client, self._overview())

    def _draw_overlay(self) -> None:
        with self._lock:
            if self._comparison is None:
                return
            share = float(self._blend.value)
            comparison = self._comparison
            difference = self._difference.value
            picture = comparison.difference() if difference else comparison.blend(share)
            if self._overlay is None:
                # Nearer than anything that could hide it, beyond the browser's near plane.
                depth = 0.05 / self._unit
                plane = photo_plane(comparison.shown.camera, depth)
                map_from_cam = se3.inverse(comparison.shown.cam_from_map)
                centre = map_from_cam[:3, :3] @ plane.centre + map_from_cam[:3, 3]
                self._overlay = self._server.scene.add_image(
                    "/photo",
                    picture,
                    self._unit * plane.width,
                    self._unit * plane.height,
                    format="jpeg",
                    wxyz=se3.to_quaternion_translation(map_from_cam)[0],
                    position=self._unit * centre,
                )
            else:
                self._overlay.image = picture
            self._overlay.visible = difference or share > 0
            self._show_others(not self._overlay.visible)

    def _show_others(self, visible: bool) -> None:
        """Those near the eye would lie before the photo."""
        self._all_cameras.visible = visible
        if self._ellipsoids is not None:
            self._ellipsoids.visible = visible

    def _remove_overlay(self) -> None:
        if self._overlay is not None:
            self._overlay.remove()
            self._overlay = None
        self._show_others(True)
        self._comparison = None
        if self._chosen is not None:
            for _, node in self._frusta[self._chosen.name]:
                node.visible = True
            self._chosen = None


def _at(trajectory: Trajectory, index: int) -> ShownCamera:
    pose: Float64Array = trajectory.cam_from_map[index]
    return ShownCamera("final", "", pose, trajectory.camera)


def _node(kind: Kind, index: int) -> str:
    return f"/cameras/{kind}/{index}"
