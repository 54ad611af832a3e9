# SPDX-License-Identifier: Apache-2.0
"""The visibility mask against its definition, with an exact renderer in the splat's place."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ROOM_POSE, RayCastRenderer, room, room_camera
from scipy.ndimage import binary_dilation, maximum_filter

from gscpe.errors import SettingsError
from gscpe.geometry import Camera, se3
from gscpe.refinement import VisibilitySettings
from gscpe.refinement.visibility import surface_mask, visibility_mask
from gscpe.render import RenderedView

CAMERA = room_camera(160, 120)
FLOATER = (slice(40, 70), slice(20, 50))  # rows and columns; the wall is behind it


def anchor_view(scale: float = 1.0) -> RenderedView:
    pose = ROOM_POSE.copy()
    pose[:3, 3] *= scale
    return RayCastRenderer(room().scaled(scale)).render(CAMERA, pose)


def mask_of(
    view: RenderedView, renderer: Any = None, metres_per_unit: float = 1.0, **settings: Any
) -> NDArray[np.bool_]:
    renderer = renderer or RayCastRenderer(room())
    settings = {"views": 2, **settings}
    return visibility_mask(renderer, view, VisibilitySettings(**settings), metres_per_unit)


def with_floater(view: RenderedView, nearer: float = 0.3) -> RenderedView:
    """A cloud in front of the wall, which no other view shows."""
    depth = view.depth.copy()
    depth[FLOATER] -= np.float32(nearer)
    return replace(view, depth=depth)


def inner_floater() -> NDArray[np.bool_]:
    """The floater without its rim, which the surface mask takes as an edge of depth."""
    inner = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    inner[41:69, 21:49] = True
    return inner


@pytest.mark.parametrize("views", [1, 2, 3, 8])
def test_a_consistent_scene_is_trusted(views: int) -> None:
    """But for a fringe that the views see behind the board: at most 2% of the picture."""
    view = anchor_view()
    surface, mask = surface_mask(view, VisibilitySettings()), mask_of(view, views=views)
    assert not np.any(mask & ~surface)
    lost = surface & ~mask
    assert lost.mean() < 0.02
    # ... no farther from the board's edge than the parallax of 5 cm; and a few in the
    # outermost of the views' pixels, which are four pixels wide.
    step = maximum_filter(view.depth, 3) - view.depth > 0.1
    assert not np.any((lost & ~binary_dilation(step, iterations=8))[4:-4, 4:-4])


def test_no_views_leave_the_surface_mask() -> None:
    view, renderer = with_floater(anchor_view()), RayCastRenderer(room())
    settings = VisibilitySettings(views=0)
    mask = visibility_mask(renderer, view, settings, 1.0)
    np.testing.assert_array_equal(mask, surface_mask(view, settings))
    assert mask[inner_floater()].all()
    assert renderer.renders == 0


def test_what_no_other_view_shows_is_masked() -> None:
    mask = mask_of(with_floater(anchor_view()))
    assert not mask[inner_floater()].any()
    assert mask[80:110, 20:50].all()  # the wall below stays


@pytest.mark.parametrize(("opacity", "trusted"), [(0.8, False), (0.95, True)])
def test_a_hole_that_is_half_closed_is_a_hole(opacity: float, trusted: bool) -> None:
    """Where a fifth of the light comes from behind, the colour and the depth are nobody's."""
    view = anchor_view()
    veil = view.opacity.copy()
    veil[80:110, 20:50] = opacity
    mask = mask_of(replace(view, opacity=veil))[80:110, 20:50]
    assert mask.all() if trusted else not mask.any()


def test_the_tolerance_is_that_of_depth() -> None:
    """A floater 1 cm off is within 2 cm, and beyond 0.2 cm; the small views' own range of
    depth over 3x3 pixels (up to 5 cm on this wall) comes on top."""
    near = with_floater(anchor_view(), nearer=0.01)
    assert mask_of(near)[inner_floater()].all()
    far = with_floater(anchor_view(), nearer=0.08)
    assert not mask_of(far)[inner_floater()].any()
    assert mask_of(far, depth_tolerance=0.2)[inner_floater()].all()


def test_edges_of_depth_are_masked() -> None:
    view = anchor_view()
    mask = surface_mask(view, VisibilitySettings())

    def jumps(share: float) -> NDArray[np.bool_]:
        """Pixels whose left or upper neighbour is nearer or farther by a share of the depth."""
        jump = np.zeros_like(mask)
        for axis in (0, 1):
            jump |= np.abs(np.diff(view.depth, axis=axis, prepend=np.nan)) > share * view.depth
        return jump

    assert jumps(0.12).sum() > 100
    assert not mask[jumps(0.12)].any()
    # Two pixels from any edge all is smooth, creases and slants included.
    assert mask[~binary_dilation(jumps(0.055), iterations=2)].all()


def test_a_pixel_against_its_definition(rng: np.random.Generator) -> None:
    depth = rng.uniform(1.0, 1.15, (12, 16)).astype(np.float32)
    depth[5, 7] = 0.0
    opacity = rng.uniform(0.8, 1.0, (12, 16)).astype(np.float32)
    camera = room_camera(16, 12)
    view = RenderedView(np.zeros((12, 16, 3), np.float32), opacity, depth, depth, camera, np.eye(4))
    mask = surface_mask(view, VisibilitySettings(min_opacity=0.9, max_depth_step=0.1))
    for row, column in np.ndindex(mask.shape):
        around = depth[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
        smooth = around.min() > 0 and around.max() - around.min() <= 0.1 * around.min()
        assert mask[row, column] == (opacity[row, column] >= 0.9 and smooth)


@dataclass
class WrongWay:
    """Answers as if the transform between the views were inverted."""

    anchor: NDArray[np.float64]

    def render(self, camera: Camera, cam_from_world: NDArray[np.float64]) -> RenderedView:
        view_from_anchor = cam_from_world @ se3.inverse(self.anchor)
        wrong = se3.inverse(view_from_anchor) @ self.anchor
        return RayCastRenderer(room()).render(camera, wrong)


def test_points_are_carried_from_the_anchor_to_the_view() -> None:
    """``v_from_anchor = v_from_world @ world_from_anchor``: with a single view half a metre
    to the side, the other direction would find the walls at other depths."""
    view, settings = anchor_view(), {"views": 1, "perturbation": 0.5, "view_scale": 1.0}
    surface = surface_mask(view, VisibilitySettings())
    right = mask_of(view, **settings)
    assert right[surface].mean() > 0.85  # the rest is hidden behind the board
    wrong = mask_of(view, WrongWay(view.cam_from_world), **settings)
    assert wrong[surface].mean() < 0.5


def test_the_views_stand_in_the_anchors_image_plane() -> None:
    """At the given distance in metres, whatever the unit of the map."""
    poses: list[NDArray[np.float64]] = []

    class Recorder(RayCastRenderer):
        def render(self, camera: Camera, cam_from_world: NDArray[np.float64]) -> RenderedView:
            poses.append(cam_from_world)
            assert (camera.width, camera.height) == (40, 30)
            return super().render(camera, cam_from_world)

    mask_of(anchor_view(), Recorder(room()), 0.5, views=3, perturbation=0.07)
    assert len(poses) == 3
    for pose in poses:
        view_from_anchor = pose @ se3.inverse(ROOM_POSE)
        np.testing.assert_allclose(view_from_anchor[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.norm(view_from_anchor[:2, 3]) == pytest.approx(0.14)
        assert view_from_anchor[2, 3] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("scale", [0.01, 10.0])
def test_units_do_not_matter(scale: float) -> None:
    scaled = mask_of(
        with_floater(anchor_view(scale), 0.3 * scale),
        RayCastRenderer(room().scaled(scale)),
        metres_per_unit=1.0 / scale,
    )
    differs = scaled != mask_of(with_floater(anchor_view()))
    assert differs.mean() < 1e-3  # pixels on the very edge of a tolerance


def test_what_no_view_sees_is_left_to_the_surface_mask() -> None:
    """Views so far aside that they look past the anchor's scene."""
    view = with_floater(anchor_view())
    mask = mask_of(view, views=1, perturbation=50.0)
    np.testing.assert_array_equal(mask, surface_mask(view, VisibilitySettings()))


def test_nothing_visible() -> None:
    view = anchor_view()
    empty = replace(view, opacity=np.zeros_like(view.opacity), depth=np.zeros_like(view.depth))
    assert not mask_of(empty).any()


@pytest.mark.parametrize(
    "settings",
    [
        {"views": -1},
        {"view_scale": 0.0},
        {"view_scale": 1.5},
        {"min_opacity": 1.1},
        {"min_votes": -0.1},
        {"depth_tolerance": -0.02},
        {"max_depth_step": -0.1},
    ],
)
def test_impossible_settings(settings: dict[str, Any]) -> None:
    with pytest.raises(SettingsError):
        VisibilitySettings(**settings)
