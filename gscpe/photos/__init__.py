# SPDX-License-Identifier: Apache-2.0
"""Pictures that cameras took: files, EXIF, sizes, masks, lens distortion."""

from gscpe.photos.exif import camera_from_exif
from gscpe.photos.image_file import read_image, read_image_of, to_uint8, write_image
from gscpe.photos.photo import Photo, luminance, to_photo

__all__ = [
    "Photo",
    "camera_from_exif",
    "luminance",
    "read_image",
    "read_image_of",
    "to_photo",
    "to_uint8",
    "write_image",
]
