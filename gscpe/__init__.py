"""Find where a photo was taken, inside a 3D Gaussian splat.

    map_ = gscpe.open_map("kitchen.gsmap")
    camera = gscpe.Camera.pinhole(640, 480, fx=525.5, fy=525.5, cx=320.0, cy=240.0)
    with gscpe.Localizer(map_) as localizer:
        result = localizer.localize(image, camera)

Frames, pixel centres and units: docs/conventions.md.
"""

from gscpe.errors import GscpeError
from gscpe.geometry import Camera, PoseDifference, pose_difference
from gscpe.localization import LocalizationResult, Localizer, LocalizerSettings, PosePrior
from gscpe.render import RenderedView, Renderer
from gscpe.scene import (
    GaussianScene,
    Map,
    References,
    camera_from_exif,
    open_map,
    read_image,
    read_splat,
    save_map,
    write_splat,
)

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "GaussianScene",
    "GscpeError",
    "LocalizationResult",
    "Localizer",
    "LocalizerSettings",
    "Map",
    "PoseDifference",
    "PosePrior",
    "References",
    "RenderedView",
    "Renderer",
    "camera_from_exif",
    "open_map",
    "pose_difference",
    "read_image",
    "read_splat",
    "save_map",
    "write_splat",
]
