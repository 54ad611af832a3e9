# SPDX-License-Identifier: Apache-2.0
"""A map from a splat alone: its references are renders from viewpoints that are found in it."""

from __future__ import annotations

import numpy as np

from gscpe.mapping.from_splat import MapSettings, check_scene
from gscpe.photos import Photo, to_uint8
from gscpe.photos.photo import LazyPhotos
from gscpe.render import Renderer
from gscpe.retrieval import check_method, describe_references
from gscpe.scene import Map, MapFrame, References
from gscpe.scene.map_frame import typical_depth
from gscpe.splats import GaussianScene
from gscpe.viewpoints import Viewpoints, ViewpointSettings, find_viewpoints

_SHOWN = 0.5


def map_with_virtual_references(
    scene: GaussianScene,
    settings: MapSettings | None = None,
    viewpoints: ViewpointSettings | Viewpoints | None = None,
    backend: str = "auto",
    *,
    progress: bool = False,
) -> Map:
    """A map of a splat without any photo or pose: viewpoints are found in its free space, and
    the renders from there are what photos are compared with to recognize a place.

    The map holds nobody's photos. ``map.references.virtual`` says that its references are
    renders.

    Args:
        scene: the splat; neither its unit nor what is up need be known.
        settings: how renders are described, and the splat's unit.
        viewpoints: how viewpoints are looked for; or the viewpoints.
        backend, progress: as :class:`gscpe.Renderer`.

    Raises:
        SplatError: the scene is something else, a path for example.
        MapError: there is no free space from which the splat shows surfaces.
        ModelError: the network that is to describe the renders is missing, or cannot be used.
        MissingDependencyError: it needs onnxruntime, and that is not installed.
        RenderError: nothing can be rendered.
    """
    check_scene(scene)
    settings = settings or MapSettings()
    check_method(settings.retrieval)
    if not isinstance(viewpoints, Viewpoints):
        viewpoints = find_viewpoints(scene, viewpoints, backend, progress=progress)
    count = len(viewpoints)
    references = References(
        names=tuple(f"virtual/{number:04d}" for number in range(1, count + 1)),
        cam_from_world=viewpoints.cam_from_world,
        cameras=(viewpoints.camera,) * count,
        virtual=True,
    )
    frame = MapFrame.around(scene, references, settings.metres_per_unit)
    in_map = frame.scene_in_map(scene, typical_depth(scene, references))
    poses = frame.cam_from_map(references.cam_from_world)
    with Renderer(in_map, backend, progress) as renderer:

        def photo(index: int) -> Photo:
            view = renderer.render(viewpoints.camera, poses[index])
            shown = np.asarray(view.opacity > _SHOWN)
            return Photo(to_uint8(view.rgb), viewpoints.camera, None if shown.all() else shown)

        descriptors = describe_references(LazyPhotos(count, photo), settings.retrieval, progress)
    return Map.of(
        scene=scene,
        references=references,
        descriptors=descriptors,
        metres_per_unit=settings.metres_per_unit,
    )
