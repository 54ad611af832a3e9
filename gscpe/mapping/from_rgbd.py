# SPDX-License-Identifier: Apache-2.0
"""A map from one RGB-D photo: a thin surfel a pixel, with fitted colours.

One fat disc a pixel would be wrong: overlapping discs composite front to back and shift
the picture on slanted surfaces by up to 0.7 px. A surfel spanned by the two one-pixel
tangent vectors of the depth map projects to a small round dot from the source view,
whatever the slant, and the blur that the dots add is taken back by fitting the colours.

Dots overlap a little, and the nearer covers the farther. On a surface that faces the camera the
slightest turn would reverse which is nearer, and shift the picture by up to 0.8 px. So neighbours
stand in four layers, a fraction of a pixel's width apart: the order is the same from all sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import PurePath

import cv2
import numpy as np

from gscpe.arrays import BoolArray, Float32Array, Float64Array, UInt8Array
from gscpe.errors import CameraError, PhotoError
from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import camera_centre
from gscpe.geometry.projection import pixel_centres, transform_points, unproject
from gscpe.geometry.se3 import check_transform, inverse
from gscpe.photos import to_photo
from gscpe.photos.image_array import check_image
from gscpe.ranges import check_kinds, check_numbers, check_whole
from gscpe.render import Renderer, choose_backend
from gscpe.retrieval import describe_references, parse_method
from gscpe.scene import Map, References
from gscpe.scene.map_frame import TYPICAL_DEPTH, MapFrame, near_plane
from gscpe.splats import GaussianScene
from gscpe.splats.gaussians import SH_C0, far_origin

_LAYERS = np.array([[0.0, 2.0], [3.0, 1.0]])
"""Depth of each 2x2 pixels' surfels, in layer spacings behind the surface: the nearest cover
most, so that the rendered depth is right on average."""


@dataclass(frozen=True)
class RgbdMapSettings:
    """How surfels are made.

    Attributes:
        surfel_sigma: standard deviation of a surfel, in pixels of the photo.
        thickness: its standard deviation along the normal, relative to that.
        opacity: of each surfel.
        layer_spacing: between the layers of neighbouring surfels, in widths of a pixel there.
        max_depth_step: relative change of depth from pixel to pixel that is an edge;
            no surfels stand there.
        colour_steps: Jacobi steps ``colour += colour_rate * (photo - render)``.
        colour_rate: see there.
        retrieval: how the photo is described; see gscpe.mapping.MapSettings.
        backend: what renders while the colours are fitted; see gscpe.render.Renderer.
    """

    surfel_sigma: float = 0.3
    thickness: float = 0.1
    opacity: float = 0.9
    layer_spacing: float = 0.25
    max_depth_step: float = 0.02
    colour_steps: int = 8
    colour_rate: float = 0.7
    retrieval: str = "vlad"
    backend: str = "auto"

    def __post_init__(self) -> None:
        parse_method(self.retrieval)
        check_kinds(self, backend=str)
        check_numbers(self, "surfel_sigma", "thickness", above=0)
        check_numbers(self, "opacity", above=0, below=1)
        check_numbers(self, "layer_spacing", least=0)
        check_numbers(self, "max_depth_step", above=0, infinite=True)
        check_whole(self, "colour_steps", least=0)
        check_numbers(self, "colour_rate", above=0, most=1)


def map_from_rgbd(
    rgb: UInt8Array,
    depth: Float32Array,
    camera: Camera,
    cam_from_world: Float64Array,
    name: str = "photo",
    settings: RgbdMapSettings | None = None,
    metres_per_unit: float | None = 1.0,
) -> Map:
    """A map whose only reference is this photo.

    Args:
        rgb, depth, camera, cam_from_world, settings: as :func:`scene_from_rgbd` takes them.
        name: of the photo.
        metres_per_unit: length of a world unit in metres; None where it is not known.

    Raises:
        PhotoError, CameraError, RenderError: as :func:`scene_from_rgbd`.
        PoseError: the pose is not a rigid transform.
        SettingsError, ModelError: of the retrieval method.
    """
    settings = settings or RgbdMapSettings()
    cam_from_world = check_transform(cam_from_world, "cam_from_world")
    rgb, depth = check_image(rgb), _checked_depth(depth)
    known = depth[np.isfinite(depth) & (depth > 0)]
    typical = float(np.median(known)) if len(known) else TYPICAL_DEPTH
    frame = MapFrame(
        origin=far_origin(camera_centre(cam_from_world), typical),
        scale=metres_per_unit or TYPICAL_DEPTH / typical,
        metres_per_unit=metres_per_unit,
    )
    cam_from_map = frame.cam_from_map(cam_from_world)
    depth_in_map = depth if frame.scale == 1.0 else (frame.scale * depth).astype(np.float32)
    return Map(
        scene=scene_from_rgbd(rgb, depth_in_map, camera, cam_from_map, settings),
        references=References((PurePath(name).name,), cam_from_map[None], (camera,)),
        descriptors=describe_references([to_photo(rgb, camera)], settings.retrieval),
        frame=frame,
    )


def scene_from_rgbd(
    rgb: UInt8Array,
    depth: Float32Array,
    camera: Camera,
    cam_from_world: Float64Array,
    settings: RgbdMapSettings | None = None,
) -> GaussianScene:
    """A splat that looks like the photo from where it was taken.

    It has the photo's detail and no more: from half a metre nearer (at 2.4 m) the surfels come
    apart and photos are not localized, from half a metre farther the pose is 1 to 2 cm off.

    Args:
        rgb: (H, W, 3) uint8 RGB, not OpenCV's BGR.
        depth: (H, W) floats, z-depth in world units; 0, NaN or infinite where unknown.
        camera: pinhole camera of both.
        cam_from_world: (4, 4), where they were taken.
        settings: see :class:`RgbdMapSettings`.

    Raises:
        PhotoError: shapes or types are wrong, or hardly a pixel has a usable depth.
        CameraError: the camera is of another image size.
        RenderError: OpenGL is missing (the colours are fitted by rendering).
    """
    settings = settings or RgbdMapSettings()
    rgb = check_image(rgb)
    depth = _checked_depth(depth)
    if not isinstance(camera, Camera):
        raise CameraError(f"the photo's camera must be a gscpe.Camera, not {camera!r}")
    camera.check_fits(rgb.shape, "the photo")
    camera.check_fits(depth.shape, "the depth image")
    if not camera.is_pinhole:
        raise PhotoError("undistort the RGB-D photo first; its camera must be a pinhole")
    cam_from_world = check_transform(cam_from_world, "cam_from_world")
    known_depth = np.zeros(depth.shape)
    np.copyto(known_depth, depth, where=np.isfinite(depth) & (depth > 0))
    chosen = _away_from_edges(known_depth, settings.max_depth_step)
    if np.count_nonzero(chosen) < 100:
        raise PhotoError("the depth image has fewer than 100 usable pixels; is its unit right?")
    surfels = _surfels(rgb, known_depth, chosen, camera, inverse(cam_from_world), settings)
    near = near_plane(float(np.median(known_depth[chosen])))
    return _fit_colours(replace(surfels, near=near), rgb, chosen, camera, cam_from_world, settings)


def _checked_depth(depth: Float32Array) -> Float32Array:
    if not isinstance(depth, np.ndarray) or depth.ndim != 2:
        found = f"shape {depth.shape}" if isinstance(depth, np.ndarray) else type(depth).__name__
        raise PhotoError(f"a depth image must be an array of shape (height, width), not {found}")
    if not np.issubdtype(depth.dtype, np.floating):
        raise PhotoError(
            f"a depth image must be of floats in world units, not {depth.dtype}; of millimetres, "
            "make metres: depth.astype(np.float32) / 1000"
        )
    return depth


def _away_from_edges(depth: Float64Array, max_step: float) -> BoolArray:
    known = depth > 0
    kernel = np.ones((3, 3), dtype=np.uint8)
    far = cv2.dilate(np.where(known, depth, 0.0), kernel)
    near = cv2.erode(np.where(known, depth, 0.0), kernel)  # 0 beside an unknown pixel
    return np.asarray(known & (near > 0) & (far - near <= 2.0 * max_step * depth))


def _surfels(
    rgb: UInt8Array,
    depth: Float64Array,
    chosen: BoolArray,
    camera: Camera,
    world_from_cam: Float64Array,
    settings: RgbdMapSettings,
) -> GaussianScene:
    # Inverse depth is linear in the pixel on a plane, so its differences are exact there.
    inverse_depth = 1.0 / np.where(depth > 0, depth, np.inf)
    by_v, by_u = (np.asarray(by) for by in np.gradient(inverse_depth))
    pixels = pixel_centres(camera)[chosen]
    z = depth[chosen]
    points_in_cam = unproject(camera, pixels, z)
    slope_u, slope_v = -z * by_u[chosen], -z * by_v[chosen]  # relative change of depth
    tangent_u = points_in_cam * slope_u[:, None]
    tangent_u[:, 0] += z / camera.fx
    tangent_v = points_in_cam * slope_v[:, None]
    tangent_v[:, 1] += z / camera.fy

    from scipy.spatial.transform import Rotation  # takes longer to import than all else

    tangents = np.stack([tangent_u, tangent_v], axis=2) * settings.surfel_sigma
    covariance = tangents @ tangents.transpose(0, 2, 1)
    variances, axes = np.linalg.eigh(covariance)  # ascending: the normal comes first
    variances[:, 0] = (settings.thickness**2) * variances[:, 1]
    axes = axes * np.reshape(np.sign(np.linalg.det(axes)), (-1, 1, 1))  # right-handed
    rotation = Rotation.from_matrix(world_from_cam[:3, :3] @ axes)
    colours = rgb[chosen].astype(np.float32) / 255.0
    rows, columns = np.nonzero(chosen)
    steps = settings.layer_spacing * _LAYERS[rows % 2, columns % 2] / camera.fx
    return GaussianScene(
        means=transform_points(world_from_cam, points_in_cam * (1.0 + steps[:, None])).astype(
            np.float32
        ),
        quaternions=rotation.as_quat(scalar_first=True).astype(np.float32),
        scales=np.sqrt(variances).astype(np.float32),
        opacities=np.full(len(z), settings.opacity, dtype=np.float32),
        sh=((colours - 0.5) / np.float32(SH_C0))[:, None, :],
    )


def _fit_colours(
    scene: GaussianScene,
    rgb: UInt8Array,
    chosen: BoolArray,
    camera: Camera,
    cam_from_world: Float64Array,
    settings: RgbdMapSettings,
) -> GaussianScene:
    target = rgb.astype(np.float32) / 255.0
    backend = choose_backend(settings.backend)
    for _ in range(settings.colour_steps):
        with Renderer(scene, backend) as renderer:
            rendered = renderer.render(camera, cam_from_world).rgb
        step = (settings.colour_rate / SH_C0) * (target - rendered)[chosen]
        scene = replace(scene, sh=scene.sh + step[:, None, :].astype(np.float32))
    return scene
