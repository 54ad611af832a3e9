# SPDX-License-Identifier: Apache-2.0
"""What a map is made of: Gaussians, reference photos, and the folder that keeps them."""

from gscpe.scene.exif import camera_from_exif
from gscpe.scene.gaussians import GaussianScene
from gscpe.scene.image_file import read_image, read_image_of, to_uint8, write_image
from gscpe.scene.map import Map
from gscpe.scene.map_folder import open_map, save_map
from gscpe.scene.map_frame import MapFrame
from gscpe.scene.photo import Photo, luminance, to_photo
from gscpe.scene.references import DescriberModel, GlobalDescriptors, References
from gscpe.scene.splat_file import read_splat
from gscpe.scene.write_splat import write_splat

__all__ = [
    "DescriberModel",
    "GaussianScene",
    "GlobalDescriptors",
    "Map",
    "MapFrame",
    "Photo",
    "References",
    "camera_from_exif",
    "luminance",
    "open_map",
    "read_image",
    "read_image_of",
    "read_splat",
    "save_map",
    "to_photo",
    "to_uint8",
    "write_image",
    "write_splat",
]
