"""Makes a map of one RGB-D photo and localizes another photo in it.

The photos are the Middlebury Motorcycle pair, which scikit-image ships; put your own
depth camera's images in their place.
"""

import numpy as np

import gscpe
from gscpe.evaluation.motorcycle import load_motorcycle
from gscpe.mapping import map_from_rgbd

pair = load_motorcycle()
map_ = map_from_rgbd(
    pair.left,  # (H, W, 3) uint8 RGB
    pair.left_depth,  # (H, W) z-depth in metres, 0 where unknown
    pair.left_camera,
    np.eye(4),  # cam_from_world of the photo: here it defines the world
)
gscpe.save_map(map_, "motorcycle.gsmap")

with gscpe.Localizer(map_) as localizer:
    result = localizer.localize(pair.right, pair.right_camera)
if result.cam_from_world is None:
    print("not localized:", result.reason)
else:
    error = gscpe.pose_difference(result.cam_from_world, pair.right_from_left)
    print(f"{1000 * error.distance:.2f} mm and {error.degrees:.4f} degrees from the true pose")
