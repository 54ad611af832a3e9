# SPDX-License-Identifier: Apache-2.0
"""Localizes one photo in a map: python examples/localize_photo.py MAP PHOTO fx fy cx cy"""

import sys

import gscpe

if len(sys.argv) != 7:
    sys.exit(__doc__)
map_folder, photo_path, *intrinsics = sys.argv[1:]
image = gscpe.read_image(photo_path)  # (H, W, 3) uint8 RGB
fx, fy, cx, cy = (float(word) for word in intrinsics)
camera = gscpe.Camera.pinhole(image.shape[1], image.shape[0], fx=fx, fy=fy, cx=cx, cy=cy)

with gscpe.Localizer(map_folder) as localizer:  # keep it for many photos
    result = localizer.localize(image, camera)

if result.cam_from_world is not None and result.covariance is not None:
    print("cam_from_world (4x4, world to camera):")
    print(result.cam_from_world)
    standard_deviations = result.covariance.diagonal() ** 0.5
    print("standard deviations (3 translation, 3 rotation in radians):", standard_deviations)
