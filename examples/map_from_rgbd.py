# SPDX-License-Identifier: Apache-2.0
"""Makes a map of one RGB-D photo and localizes another photo in it.

The photos are the Middlebury Motorcycle pair, which scikit-image ships; put your own
depth camera's images in their place.
"""

import numpy as np
import skimage.data

import gscpe

# Two (H, W, 3) uint8 RGB photos, and how many pixels each pixel of the left one moves, (H, W).
left, right, disparity = skimage.data.stereo_motorcycle()
height, width = left.shape[:2]
focal, baseline = 994.978, 0.193001  # pixels, metres; from Middlebury's calib.txt, as those below
left_cx, right_cx, cy = 311.193 + 0.5, 342.279 + 0.5, 254.877 + 0.5  # + 0.5: theirs are OpenCV's
left_camera = gscpe.Camera.pinhole(width, height, fx=focal, fy=focal, cx=left_cx, cy=cy)
right_camera = gscpe.Camera.pinhole(width, height, fx=focal, fy=focal, cx=right_cx, cy=cy)
known = np.isfinite(disparity)
shift = np.where(known, disparity, np.inf) + right_cx - left_cx
depth = focal * baseline / shift  # z-depth in metres, 0 where unknown

map_ = gscpe.map_from_rgbd(
    left,
    depth.astype(np.float32),
    left_camera,
    np.eye(4),  # cam_from_world of the photo: here it defines the world
)
gscpe.save_map(map_, "motorcycle.gsmap")

with gscpe.Localizer(map_) as localizer:
    result = localizer.localize(right, right_camera)
print(result)
if result.cam_from_world is not None:
    true_cam_from_world = np.eye(4)
    true_cam_from_world[0, 3] = -baseline  # the right camera stands a baseline beside the left one
    error = gscpe.pose_difference(result.cam_from_world, true_cam_from_world)
    print(f"{1000 * error.distance:.2f} mm and {error.degrees:.4f} degrees from the true pose")
