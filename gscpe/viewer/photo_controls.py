# SPDX-License-Identifier: Apache-2.0
"""The photos in the panel: their lists, and one of them laid over the map."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from gscpe.geometry import se3
from gscpe.render import Renderer
from gscpe.scene import MapFrame
from gscpe.viewer.camera_nodes import CameraNodes
from gscpe.viewer.cameras import ShownCamera, Viewpoint, photo_plane, viewpoint_of
from gscpe.viewer.contents import Contents
from gscpe.viewer.flight import Flight
from gscpe.viewer.photo_over_map import PhotoOverMap, photo_over_map
from gscpe.viewer.photos import Photos
from gscpe.viewer.texts import name_options, photo_html

if TYPE_CHECKING:
    import viser

_NONE = "\N{EM DASH}"


class PhotoControls:
    """Lists of photos, where one flies when one is chosen, and what is laid over the map there.
    Made where the panel is being filled.

    Args:
        server: of the page.
        flight: moves the eyes.
        frame: of the map.
        photos: that can be laid over it.
        renderer: of what they are compared with; it is not closed.

    Attributes:
        begin: where one looks from at first.
        afar: where all cameras are seen from. None, both: one does not fly there.
        about: says what is known of the chosen photo.
        overlay: the node of the photo that lies over the map, or None.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        flight: Flight,
        frame: MapFrame,
        photos: Photos,
        renderer: Renderer,
    ) -> None:
        self._server, self._flight, self._frame = server, flight, frame
        self._photos, self._renderer = photos, renderer
        self.begin: Viewpoint | None = None
        self.afar: Viewpoint | None = None
        self._contents: Contents | None = None
        self._nodes: CameraNodes | None = None
        self._comparison: PhotoOverMap | None = None
        self._chosen: ShownCamera | None = None
        self._lock = threading.RLock()
        self.overlay: Any = None
        gui = server.gui
        self._queries = self._add_dropdown("Photo", reference=False)
        self._references = self._add_dropdown("Reference", reference=True)
        self._blend = gui.add_slider("Photo over map", 0.0, 1.0, 0.01, 0.5)
        self._blend.on_update(lambda _: self._draw_overlay())
        self._difference = gui.add_checkbox("Difference, 4 times", False)
        self._difference.on_update(lambda _: self._draw_overlay())
        self.about = gui.add_html("")
        back = gui.add_button("Back to the start")
        back.on_click(lambda event: self.leave(event.client, self.begin))
        afar = gui.add_button("All cameras, from afar")
        afar.on_click(lambda event: self.leave(event.client, self.afar))

    def show(self, contents: Contents, nodes: CameraNodes) -> None:
        """Lists the photos that there are, of which the nodes are drawn."""
        with self._lock:
            self._contents, self._nodes = contents, nodes
            for dropdown, reference in ((self._queries, False), (self._references, True)):
                options = _options(contents, reference)
                if dropdown.options != (_NONE, *options):
                    dropdown.options = (_NONE, *options)
                dropdown.visible = bool(options)
            if self._chosen is not None:
                nodes.show_photo(self._chosen.name, False)

    def go(self, client: viser.ClientHandle, shown: ShownCamera) -> None:
        """Flies to a camera and lays its photo over the map."""
        with self._lock:
            self._remove_overlay()
            self._flight.fly(client, viewpoint_of(shown, client.camera.aspect))
            self._chosen = shown
            assert self._nodes is not None
            assert self._contents is not None
            self._nodes.show_photo(shown.name, False)  # it would lie before what it shows
            self._comparison = photo_over_map(shown, self._photos, self._renderer)
            self.about.content = photo_html(
                shown, self._contents, self._frame, self._comparison is not None
            )
            self._draw_overlay()

    def leave(self, client: viser.ClientHandle | None, goal: Viewpoint | None) -> None:
        """Takes the photo away, and flies to where more is seen."""
        with self._lock:
            self._remove_overlay()
            if client is not None and goal is not None:
                self._flight.fly(client, goal)

    def _add_dropdown(self, label: str, reference: bool) -> Any:
        dropdown = self._server.gui.add_dropdown(label, (_NONE,), visible=False)

        @dropdown.on_update
        def _(event: Any) -> None:
            contents = self._contents
            if event.client is None or contents is None or dropdown.value == _NONE:
                return
            name = _options(contents, reference).get(dropdown.value)
            if name is None:
                return
            cameras = contents.of_kind("reference") if reference else ()
            shown = next((c for c in cameras if c.name == name), contents.best(name))
            if shown is not None:
                self.go(event.client, shown)

        return dropdown

    def _draw_overlay(self) -> None:
        with self._lock:
            if self._comparison is None:
                return
            share = float(self._blend.value)
            comparison = self._comparison
            difference = self._difference.value
            picture = comparison.difference() if difference else comparison.blend(share)
            if self.overlay is None:
                unit = self._flight.unit
                # Nearer than anything that could hide it, beyond the browser's near plane.
                plane = photo_plane(comparison.shown.camera, 0.05 / unit)
                map_from_cam = se3.inverse(comparison.shown.cam_from_map)
                centre = map_from_cam[:3, :3] @ plane.centre + map_from_cam[:3, 3]
                self.overlay = self._server.scene.add_image(
                    "/photo",
                    picture,
                    unit * plane.width,
                    unit * plane.height,
                    format="jpeg",
                    wxyz=se3.to_quaternion_translation(map_from_cam)[0],
                    position=unit * centre,
                )
            else:
                self.overlay.image = picture
            self.overlay.visible = difference or share > 0
            self._show_others(not self.overlay.visible)

    def _show_others(self, visible: bool) -> None:
        """Those near the eye would lie before the photo."""
        if self._nodes is not None:
            self._nodes.show_all(visible)

    def _remove_overlay(self) -> None:
        if self.overlay is not None:
            self.overlay.remove()
            self.overlay = None
        self._show_others(True)
        self._comparison = None
        if self._chosen is not None and self._nodes is not None:
            self._nodes.show_photo(self._chosen.name, True)
            self._chosen = None


def _options(contents: Contents, reference: bool) -> dict[str, str]:
    """Names of photos, by what their list shows."""
    if reference:
        return name_options([c.name for c in contents.of_kind("reference")], ())
    names = dict.fromkeys(c.name for c in contents.cameras if c.kind != "reference")
    return name_options(names, {each.name for each in contents.refused})
