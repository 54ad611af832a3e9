# SPDX-License-Identifier: Apache-2.0
"""Photos or a video in, a map out."""

from __future__ import annotations

import hashlib
import logging
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Mapping, Sequence

import numpy as np

from gscpe.arrays import Float64Array
from gscpe.errors import OutputError, PoseError, ReconstructionError, SettingsError, TrainingError
from gscpe.geometry.camera import Camera
from gscpe.making.certificate import Certificate, certify
from gscpe.making.certificate_page import write_certificate_page
from gscpe.making.settings import MakeMapSettings
from gscpe.mapping import MapSettings, build_map
from gscpe.reconstruction import (
    Reconstruction,
    ScaleSource,
    mask_path,
    open_work_folder,
    read_mask,
    reconstruct,
)
from gscpe.retrieval import check_method
from gscpe.scene import Photo, References, open_map, read_image_of, read_splat, save_map, to_photo
from gscpe.scene.colmap_model import read_colmap_references
from gscpe.scene.map_folder import CERTIFICATE, CERTIFICATE_PAGE, check_map_output
from gscpe.scene.photo import resized_photo
from gscpe.scene.poses import write_colmap_folder
from gscpe.scene.write_splat import write_splat

if TYPE_CHECKING:  # importing it needs Numba
    from gscpe.training import TrainingSettings

_log = logging.getLogger(__name__)

_SPLAT = "splat.ply"
_FINISHED = "finished"
_LEAST_LEARNED = 3


@dataclass(frozen=True)
class KnownPoses:
    """Photos whose poses are known already.

    Attributes:
        image_folder: of the photos.
        colmap: a COLMAP model of them; or
        poses, cameras: ``cam_from_world``, (4, 4), and camera by name.
        metres_per_unit: of the poses; None where it is not known.
    """

    image_folder: Path
    colmap: Path | None = None
    poses: Mapping[str, Float64Array] | None = None
    cameras: Mapping[str, Camera] | None = None
    metres_per_unit: float | None = None


@dataclass(frozen=True)
class MadeMap:
    """What came of it.

    Attributes:
        folder: of the map.
        gaussians, references: how many it has.
        reconstruction: of the photos; None where their poses were known.
        certificate: None where no photo was left out.
        page: the certificate for people; None without.
    """

    folder: Path
    gaussians: int
    references: int
    reconstruction: Reconstruction | None
    certificate: Certificate | None
    page: Path | None


def work_folder_of(output: str | Path) -> Path:
    """What is not finished yet lies beside the map."""
    output = Path(output).absolute()
    return output.with_name(output.name + ".work")


def make_map(
    source: str | Path | Sequence[str | Path] | KnownPoses,
    output: str | Path,
    settings: MakeMapSettings | None = None,
    scale: ScaleSource | None = None,
    masks: str | Path | None = None,
    resume: bool = False,
    backend: str = "auto",
    progress: bool = False,
    reconstructed: Callable[[Reconstruction], None] | None = None,
) -> MadeMap:
    """A map of photos or videos: structure from motion, training, and the map's certificate.

    All steps leave what they made in a folder beside the output, ``OUTPUT.work``; after Ctrl-C, a
    crash or a full disk, ``resume`` goes on there. It may be deleted once the map is made; the
    model (``model/sparse/0``), its photos and the splat (``splat.ply``) are in it.

    Args:
        source: as of :func:`gscpe.reconstruct`; or photos with known poses.
        output: the map's folder.
        settings: how.
        scale: where the unit comes from; by default it stays unknown.
        masks: folder of pictures named like the photos, black where these do not count.
        resume: go on where a run was interrupted.
        backend: that the certificate's photos are localized with, see :class:`gscpe.Renderer`.
        progress: show bars.
        reconstructed: is told, before the long training, which photos were placed.

    Raises:
        ReconstructionError: as :func:`gscpe.reconstruct`.
        ColmapModelError: a known model cannot be read, is of other photos, or has no points
            and none can be triangulated.
        TrainingError: too few photos have a pose.
        PhotoError, CameraError: a photo or a mask cannot be used.
        OutputError: something cannot be written; another run is in the way.
        SettingsError, ModelError, MissingDependencyError: of the retrieval method, pycolmap, Numba.
    """
    settings, scale = settings or MakeMapSettings(), scale or ScaleSource()
    training = _training_settings(settings)  # before any work: it needs Numba
    if isinstance(source, KnownPoses) and scale.kind != "unknown":
        raise SettingsError("known poses have a scale: give metres_per_unit, and no other scale")
    check_method(settings.retrieval)
    check_map_output(output)
    output, work = Path(output).absolute(), work_folder_of(output)
    open_work_folder(work, _stamp(source, settings, masks), resume, _FINISHED)
    reconstruction = None
    if isinstance(source, KnownPoses):
        model, images, unit = (
            _known_model(source, work),
            source.image_folder,
            source.metres_per_unit,
        )
    else:
        reconstruction = reconstruct(
            source,
            work / "model",
            settings.reconstruction,
            scale,
            masks,
            resume=(work / "model").exists(),
            progress=progress,
        )
        if reconstructed is not None:
            reconstructed(reconstruction)
        model, images = reconstruction.model_folder, reconstruction.image_folder
        unit = reconstruction.frame.metres_per_unit
    references = read_colmap_references(model, images)
    learned, left_out = split(references, settings.test_every)
    splat = work / _SPLAT
    if not (splat.exists() and resume):
        max_size = settings.reconstruction.max_size
        _train(learned, model, images, splat, training, max_size, masks, progress)
    scene = read_splat(splat)
    map_ = build_map(scene, learned, images, MapSettings(settings.retrieval, unit), progress)
    save_map(map_, output)
    certificate = page = None
    if len(left_out):
        certificate, pictures = certify(
            open_map(output), left_out, images, settings.certificate, backend, progress=progress
        )
        page = output / CERTIFICATE_PAGE
        facts = {"structure from motion": str(reconstruction)} if reconstruction else {}
        write_certificate_page(page, output.name, certificate, pictures, facts)
        try:
            (output / CERTIFICATE).write_text(certificate.to_json(), encoding="utf-8")
        except OSError as error:
            raise OutputError(f"{output / CERTIFICATE} cannot be written: {error}") from error
    (work / _FINISHED).touch()
    return MadeMap(output, len(scene), len(learned), reconstruction, certificate, page)


def split(references: References, test_every: int) -> tuple[References, References]:
    """Those that a map is made of, and those that are left out: the first of so many, by name; none
    for 0.

    Raises:
        TrainingError: too few remain.
    """
    indices = np.arange(len(references))
    out = indices % test_every == 0 if test_every else np.zeros(len(references), dtype=bool)
    learned, left_out = (_some(references, indices[chosen]) for chosen in (~out, out))
    if len(learned) < _LEAST_LEARNED:
        raise TrainingError(
            f"{len(references)} photos have a pose, of which {len(learned)} can be trained on; at "
            f"least {_LEAST_LEARNED} are needed"
        )
    return learned, left_out


def _some(references: References, indices: Any) -> References:
    return References(
        tuple(references.names[i] for i in indices),
        references.cam_from_world[indices],
        tuple(references.cameras[i] for i in indices),
    )


def _training_settings(settings: MakeMapSettings) -> TrainingSettings:
    from gscpe.training import TrainingSettings

    return TrainingSettings(
        iterations=(
            TrainingSettings.iterations if settings.iterations is None else settings.iterations
        ),
        minutes=settings.minutes if settings.iterations is None else None,
        max_gaussians=settings.max_gaussians,
        seed=settings.seed,
    )


def _train(
    learned: References,
    model: Path,
    images: Path,
    splat: Path,
    settings: TrainingSettings,
    max_size: int,
    masks: str | Path | None,
    progress: bool,
) -> None:
    """Writes the splat; its checkpoint lies beside it meanwhile."""
    from contextlib import closing, nullcontext

    from gscpe.training import (
        ProgressBar,
        checkpoint_of,
        read_colmap_points,
        train,
        triangulated_points,
    )

    points = read_colmap_points(model)
    if points is None:
        _log.warning("%s has hardly any points: triangulating some", model)
        points = triangulated_points(model, images)
    checkpoint = checkpoint_of(splat)
    folder = None if masks is None else Path(masks)
    photos = [_photo(learned, i, images, max_size, folder) for i in range(len(learned))]
    with closing(ProgressBar()) if progress else nullcontext() as bar:
        scene = train(
            photos,
            learned.cam_from_world,
            points,
            settings,
            bar,
            checkpoint,
            resume=checkpoint.exists(),
            seen=points.seen_in(learned.names),
        )
    write_splat(scene, splat)
    checkpoint.unlink()


def _photo(
    references: References, index: int, images: Path, max_size: int, masks: Path | None
) -> Photo:
    name, camera = references.names[index], references.cameras[index]
    image = read_image_of(images / name, camera)
    path = None if masks is None else mask_path(masks, name)
    if path is not None:
        seen = read_mask(path, camera.width, camera.height)
        opacity = (
            np.full(seen.shape, 255, dtype=np.uint8) if image.shape[2] == 3 else image[:, :, 3]
        )
        image = np.dstack([image[:, :, :3], np.where(seen, opacity, 0).astype(np.uint8)])
    photo = to_photo(image, camera)
    smaller = max_size / max(photo.camera.width, photo.camera.height)
    return resized_photo(photo, smaller) if smaller < 1.0 else photo


def _known_model(source: KnownPoses, work: Path) -> Path:
    """A COLMAP model of the photos."""
    if source.colmap is not None:
        return source.colmap
    if not source.poses:
        raise PoseError("known poses are a COLMAP model, or poses and cameras by photo")
    missing = [name for name in source.poses if not (source.image_folder / name).is_file()]
    if missing:
        raise ReconstructionError(
            f"{len(missing)} of the {len(source.poses)} photos with known poses are not in "
            f"{source.image_folder}, the first is {missing[0]}"
        )
    folder = work / "known"
    shutil.rmtree(folder, ignore_errors=True)
    write_colmap_folder(folder, dict(sorted(source.poses.items())), source.cameras)
    return folder


def _stamp(
    source: str | Path | Sequence[str | Path] | KnownPoses,
    settings: MakeMapSettings,
    masks: str | Path | None,
) -> dict[str, Any]:
    """What cannot be changed on the way. Photos and how they are put together are looked at by
    :func:`gscpe.reconstruct`; the minutes may be prolonged."""
    stamp: dict[str, Any] = {
        "iterations": settings.iterations,
        "max_gaussians": settings.max_gaussians,
        "test_every": settings.test_every,
        "seed": settings.seed,
        "masks": None if masks is None else str(Path(masks).resolve()),
        "reconstruction": asdict(settings.reconstruction),
    }
    if isinstance(source, KnownPoses):
        stamp["photos"] = str(source.image_folder.resolve())
        stamp["poses"] = _fingerprint(source)
    return stamp


def _fingerprint(source: KnownPoses) -> str:
    """Changes with the poses and cameras, wherever they are from."""
    known = hashlib.sha256()
    if source.colmap is not None:
        for path in sorted(path for path in source.colmap.rglob("*") if path.is_file()):
            known.update(path.name.encode() + path.read_bytes())
    for name, pose in sorted((source.poses or {}).items()):
        known.update(name.encode() + np.asarray(pose, dtype=np.float64).tobytes())
    for name, camera in sorted((source.cameras or {}).items()):
        known.update(f"{name} {camera!r}".encode())
    return known.hexdigest()
