# SPDX-License-Identifier: Apache-2.0
"""Pure NumPy geometry: SE(3), cameras, projection. No files, no OpenGL.

Conventions (docs/conventions.md): ``cam_from_world`` maps world points into an
OpenCV camera frame (x right, y down, z forward); the centre of the top-left
pixel is (0.5, 0.5); tangent vectors are (translation, rotation).
"""

from gscpe.geometry.camera import Camera
from gscpe.geometry.pose_error import PoseDifference, pose_difference

__all__ = ["Camera", "PoseDifference", "pose_difference"]
