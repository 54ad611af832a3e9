# SPDX-License-Identifier: Apache-2.0
"""Find where a photo was taken, inside a 3D Gaussian splat.

    camera = gscpe.Camera.pinhole(640, 480, fx=525.5, fy=525.5, cx=320.0, cy=240.0)
    with gscpe.Localizer("kitchen.gsmap") as localizer:
        result = localizer.localize(gscpe.read_image("photo.jpg"), camera)

All that a program needs is in this module (docs/api.md); the modules below it may change.
Frames, pixel centres and units: docs/conventions.md.
"""

from typing import TYPE_CHECKING, Any

from gscpe.coarse import (
    AbsolutePose,
    CameraEstimate,
    CoarseObserver,
    CoarseResult,
    CoarseSettings,
    IntrinsicsSettings,
    PnPSettings,
)
from gscpe.errors import (
    CameraError,
    ClosedError,
    ColmapModelError,
    DatasetError,
    GscpeError,
    InputError,
    MapError,
    MissingDependencyError,
    ModelError,
    OutputError,
    PhotoError,
    PoseError,
    QueryListError,
    ReconstructionError,
    RenderError,
    SequenceError,
    ServiceError,
    SettingsError,
    SplatError,
    TrainingError,
    WorkerError,
)
from gscpe.geometry import Camera, PoseDifference, pose_difference
from gscpe.geometry.similarity_transform import Similarity
from gscpe.localization import (
    Attempt,
    CameraCheckSettings,
    EasySettings,
    FusionSettings,
    LocalizationResult,
    Localizer,
    LocalizerSettings,
    Observer,
    PosePrior,
    Start,
    VerificationSettings,
)
from gscpe.mapping import (
    CheckedReference,
    FrameCheckSettings,
    MapCheck,
    MapCheckSettings,
    MapSettings,
    Misfit,
    RgbdMapSettings,
    build_map,
    check_frames,
    check_map,
    map_from_rgbd,
    map_with_virtual_references,
    map_without_references,
    measure_misfit,
    read_transform,
    scene_from_rgbd,
    with_fitting_axes,
)
from gscpe.matching import Matcher, Matches, make_matcher
from gscpe.photos import Photo, camera_from_exif, read_image, to_photo, write_image
from gscpe.poses import PoseFile, read_pose_file, write_pose_file
from gscpe.refinement import (
    Alignment,
    ClippingSettings,
    IlluminationSettings,
    LightSettings,
    LucasKanadeSettings,
    RefinementObserver,
    RefinementResult,
    RefinementSettings,
    UncertaintySettings,
    VisibilitySettings,
)
from gscpe.render import RenderedView, Renderer, Renders
from gscpe.retrieval import IndexSettings
from gscpe.scene import (
    DescriberModel,
    GlobalDescriptors,
    Map,
    MapFrame,
    References,
    open_map,
    save_map,
)
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.moved import move_references, move_scene
from gscpe.scene.query_list import Query, read_query_list
from gscpe.splats import GaussianScene, read_splat, write_splat
from gscpe.viewpoints import Viewpoints, ViewpointSettings, find_viewpoints

if TYPE_CHECKING:
    from gscpe.benchmark import BenchmarkSettings as BenchmarkSettings
    from gscpe.benchmark import benchmark_scene as benchmark_scene
    from gscpe.datasets import Dataset as Dataset
    from gscpe.datasets import read_cambridge as read_cambridge
    from gscpe.datasets import read_colmap as read_colmap
    from gscpe.datasets import read_fast_livo2 as read_fast_livo2
    from gscpe.datasets import read_rgbd_folder as read_rgbd_folder
    from gscpe.datasets import read_seven_scenes as read_seven_scenes
    from gscpe.datasets import read_transforms as read_transforms
    from gscpe.evaluation import Evaluation as Evaluation
    from gscpe.evaluation import SceneRun as SceneRun
    from gscpe.evaluation import evaluate as evaluate
    from gscpe.making import Certificate as Certificate
    from gscpe.making import CertificateSettings as CertificateSettings
    from gscpe.making import CertifiedPhoto as CertifiedPhoto
    from gscpe.making import MadeMap as MadeMap
    from gscpe.making import MakeMapSettings as MakeMapSettings
    from gscpe.making import make_map as make_map
    from gscpe.making import read_certificate as read_certificate
    from gscpe.reconstruction import KnownLengths as KnownLengths
    from gscpe.reconstruction import KnownPoses as KnownPoses
    from gscpe.reconstruction import ModelFrame as ModelFrame
    from gscpe.reconstruction import PoseRefinementSettings as PoseRefinementSettings
    from gscpe.reconstruction import Reconstruction as Reconstruction
    from gscpe.reconstruction import ReconstructionSettings as ReconstructionSettings
    from gscpe.reconstruction import RefinedPoses as RefinedPoses
    from gscpe.reconstruction import ScaleSource as ScaleSource
    from gscpe.reconstruction import read_lengths as read_lengths
    from gscpe.reconstruction import reconstruct as reconstruct
    from gscpe.reconstruction import refine_known_poses as refine_known_poses
    from gscpe.report import ReportSettings as ReportSettings
    from gscpe.report import ShownResult as ShownResult
    from gscpe.report import show as show
    from gscpe.sequences import Frame as Frame
    from gscpe.sequences import Frames as Frames
    from gscpe.sequences import open_frames as open_frames
    from gscpe.service import Client as Client
    from gscpe.tracking import Motion as Motion
    from gscpe.tracking import Tracker as Tracker
    from gscpe.tracking import TrackingResult as TrackingResult
    from gscpe.tracking import TrackingSettings as TrackingSettings
    from gscpe.tracking import TrustSettings as TrustSettings
else:
    # Importing these takes a third as long as all of the rest, and few programs need them.
    _ON_DEMAND = {
        "gscpe.benchmark": ("BenchmarkSettings", "benchmark_scene"),
        "gscpe.datasets": (
            *("Dataset", "read_cambridge", "read_colmap", "read_fast_livo2"),
            *("read_rgbd_folder", "read_seven_scenes", "read_transforms"),
        ),
        "gscpe.evaluation": ("Evaluation", "SceneRun", "evaluate"),
        "gscpe.making": (
            *("Certificate", "CertificateSettings", "CertifiedPhoto", "MadeMap"),
            *("MakeMapSettings", "make_map", "read_certificate"),
        ),
        "gscpe.reconstruction": (
            *("KnownLengths", "KnownPoses", "ModelFrame", "PoseRefinementSettings"),
            *("Reconstruction", "ReconstructionSettings", "RefinedPoses", "ScaleSource"),
            *("read_lengths", "reconstruct", "refine_known_poses"),
        ),
        "gscpe.report": ("ReportSettings", "ShownResult", "show"),
        "gscpe.sequences": ("Frame", "Frames", "open_frames"),
        "gscpe.service": ("Client",),
        "gscpe.tracking": (
            *("Motion", "Tracker", "TrackingResult", "TrackingSettings", "TrustSettings"),
        ),
    }

    def __getattr__(name: str) -> Any:
        from importlib import import_module

        for module, names in _ON_DEMAND.items():
            if name in names:
                return getattr(import_module(module), name)
        raise AttributeError(f"module 'gscpe' has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})


__version__ = "0.1.0"

__all__ = [
    "AbsolutePose",
    "Alignment",
    "Attempt",
    "BenchmarkSettings",
    "Camera",
    "CameraCheckSettings",
    "CameraError",
    "CameraEstimate",
    "Certificate",
    "CertificateSettings",
    "CertifiedPhoto",
    "CheckedReference",
    "Client",
    "ClippingSettings",
    "ClosedError",
    "CoarseObserver",
    "CoarseResult",
    "CoarseSettings",
    "ColmapModelError",
    "Dataset",
    "DatasetError",
    "DescriberModel",
    "EasySettings",
    "Evaluation",
    "Frame",
    "FrameCheckSettings",
    "Frames",
    "FusionSettings",
    "GaussianScene",
    "GlobalDescriptors",
    "GscpeError",
    "IlluminationSettings",
    "IndexSettings",
    "InputError",
    "IntrinsicsSettings",
    "KnownLengths",
    "KnownPoses",
    "LightSettings",
    "LocalizationResult",
    "Localizer",
    "LocalizerSettings",
    "LucasKanadeSettings",
    "MadeMap",
    "MakeMapSettings",
    "Map",
    "MapCheck",
    "MapCheckSettings",
    "MapError",
    "MapFrame",
    "MapSettings",
    "Matcher",
    "Matches",
    "Misfit",
    "MissingDependencyError",
    "ModelError",
    "ModelFrame",
    "Motion",
    "Observer",
    "OutputError",
    "Photo",
    "PhotoError",
    "PnPSettings",
    "PoseDifference",
    "PoseError",
    "PoseFile",
    "PosePrior",
    "PoseRefinementSettings",
    "Query",
    "QueryListError",
    "Reconstruction",
    "ReconstructionError",
    "ReconstructionSettings",
    "References",
    "RefinedPoses",
    "RefinementObserver",
    "RefinementResult",
    "RefinementSettings",
    "RenderError",
    "RenderedView",
    "Renderer",
    "Renders",
    "ReportSettings",
    "RgbdMapSettings",
    "ScaleSource",
    "SceneRun",
    "SequenceError",
    "ServiceError",
    "SettingsError",
    "ShownResult",
    "Similarity",
    "SplatError",
    "Start",
    "Tracker",
    "TrackingResult",
    "TrackingSettings",
    "TrainingError",
    "TrustSettings",
    "UncertaintySettings",
    "VerificationSettings",
    "ViewpointSettings",
    "Viewpoints",
    "VisibilitySettings",
    "WorkerError",
    "benchmark_scene",
    "build_map",
    "camera_from_exif",
    "check_frames",
    "check_map",
    "evaluate",
    "find_viewpoints",
    "make_map",
    "make_matcher",
    "map_from_rgbd",
    "map_with_virtual_references",
    "map_without_references",
    "measure_misfit",
    "move_references",
    "move_scene",
    "open_frames",
    "open_map",
    "pose_difference",
    "read_cambridge",
    "read_certificate",
    "read_colmap",
    "read_colmap_references",
    "read_fast_livo2",
    "read_image",
    "read_lengths",
    "read_pose_file",
    "read_query_list",
    "read_rgbd_folder",
    "read_seven_scenes",
    "read_splat",
    "read_transform",
    "read_transforms",
    "reconstruct",
    "refine_known_poses",
    "save_map",
    "scene_from_rgbd",
    "show",
    "to_photo",
    "with_fitting_axes",
    "write_image",
    "write_pose_file",
    "write_splat",
]
